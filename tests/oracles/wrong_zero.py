"""The plant with a joint whose counter is off, or began anew; counts what enables drives and moves."""

from dataclasses import replace

from hardware.arm import ArmIdentity, NodeIdentity
from hardware.virtual.scenarios import Scenario, scenario
from operator_app.config.procedure import Procedure
from tests.oracles.plant_arm import PlantArm


class WrongZero(PlantArm):
    """See the module."""

    def __init__(self, procedure: Procedure, chosen: Scenario | None = None) -> None:
        super().__init__(procedure, chosen or scenario("datasheet", seed=3))
        self.serials = {j: 100 + j for j in range(1, 8)}
        self.enabled = self.moved = 0
        self.before_end = (0, 0)

    def begin_anew(self, joint: int) -> None:
        self.off_rad[joint - 1] = -self._positions()[joint - 1]

    def connect(self) -> ArmIdentity:
        nodes = tuple(
            NodeIdentity(
                node=j, role=f"joint {j}", device_name="drive", vendor_id=0, product_code=1, revision=1,
                serial_number=serial,
            )
            for j, serial in self.serials.items()
        )  # fmt: skip
        return replace(super().connect(), nodes=nodes)

    def take_control(self) -> None:
        self.enabled += 1
        super().take_control()

    def move(self, *args: object, **kwargs: object) -> object:  # type: ignore[override]
        self.moved += 1
        return super().move(*args, **kwargs)  # type: ignore[arg-type]
