"""The `Arm` interface and its data types, for packages that add an arm to ``sarcal``.

``sarcal help outside-arm`` shows a complete package. The package has an entry point NAME in the group ``sarcal.arm``,
which refers to an `ArmOffer`. With ``-i NAME -c CHANNEL``, `sarcal` passes an `ArmOrder` to this offer.

Angles are sensor readings, rad. `identity_of`, `snapshot_of` and `reading_of` make the objects that an arm returns.
`SimulatedChain` is a simulated arm in a fixture, for tests of the package. The names in ``__all__`` are as stable as
those of `sarcal`. Objects made by `sarcal` may get new fields; objects made by an arm get only fields with defaults.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hardware.arm import (
    SIMULATED_NAME,
    ArmIdentity,
    ArmSnapshot,
    DriveState,
    Fault,
    JointMode,
    JointState,
    MoveResult,
    NodeIdentity,
    Reading,
    UploadReceipt,
    Watch,
)
from hardware.arm import ArmInterface as Arm
from hardware.arm_description import ArmDescription, JointDescription
from hardware.arm_plugins import GROUP, ArmOffer, ArmOrder
from hardware.errors import (
    BusError,
    CommandRefused,
    DriveFault,
    HardwareError,
    ModeNotReached,
    SensorFault,
    Stopped,
    UploadRefused,
    UploadUnknown,
)
from hardware.virtual import DEFAULT_SCENARIO
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import virtual_arm
from solver.arrays import FloatArray, frozen

__all__ = [
    "GROUP",
    "SIMULATED_NAME",
    "Arm",
    "ArmDescription",
    "ArmIdentity",
    "ArmOffer",
    "ArmOrder",
    "ArmSnapshot",
    "BusError",
    "CommandRefused",
    "DriveFault",
    "DriveState",
    "Fault",
    "HardwareError",
    "JointDescription",
    "JointMode",
    "JointState",
    "ModeNotReached",
    "MoveResult",
    "NodeIdentity",
    "Reading",
    "SensorFault",
    "SimulatedChain",
    "Stopped",
    "UploadReceipt",
    "UploadRefused",
    "UploadUnknown",
    "Watch",
    "identity_of",
    "reading_of",
    "snapshot_of",
]


def identity_of(
    order: ArmOrder,
    *,
    serial_number: str,
    speaks: str,
    device_name: str = "",
    by_hand: bool = False,
) -> ArmIdentity:
    """Return the identity of an arm whose joint drives have no identities of their own.

    `serial_number` must differ between arms, so that a session never has poses of two arms. `speaks`: name of the
    protocol for texts to the operator, such as ``"JSON"``. A simulated arm has a `device_name` that begins with
    `SIMULATED_NAME`. `by_hand`: only a person moves the arm, so no hardware stop is required.
    """
    nodes = tuple(
        NodeIdentity(
            node=number,
            role=f"joint {number}",
            device_name=device_name,
            vendor_id=0,
            product_code=0,
            revision=0,
            serial_number=0,
        )
        for number in range(1, len(order.description.joints) + 1)
    )
    return ArmIdentity(
        model=order.description.model,
        serial_number=serial_number,
        nodes=nodes,
        speaks=speaks,
        by_hand=by_hand,
    )


def snapshot_of(
    order: ArmOrder,
    angles_rad: ArrayLike,
    *,
    sample: int,
    age_s: float,
    modes: Sequence[JointMode | None],
    enabled: bool,
    torques_nm: ArrayLike | None = None,
    moving: bool = False,
) -> ArmSnapshot:
    """Return the state of an arm at its latest sample, which has the number `sample` and is `age_s` seconds old.

    `angles_rad`, `torques_nm` and `modes` have one entry per joint. If `torques_nm` is None, all torques are zero.
    """
    joints = order.description.joints
    angles = np.asarray(angles_rad, dtype=float)
    torques = np.zeros(len(joints)) if torques_nm is None else np.asarray(torques_nm, dtype=float)
    drive = DriveState.OPERATION_ENABLED if enabled else DriveState.SWITCH_ON_DISABLED
    states = tuple(
        JointState(
            joint=number,
            position_counts=round(joint.scale.counts_of(float(angle))),
            position_rad=float(angle),
            speed_rad_per_s=0.0,
            torque_nm=float(torque),
            drive=drive,
            mode=mode,
            age_s=age_s,
        )
        for number, (joint, angle, torque, mode) in enumerate(
            zip(joints, angles, torques, modes, strict=True), 1
        )
    )
    return ArmSnapshot(
        sync_count=sample,
        joints=states,
        heartbeat_age_s={},
        token=0,
        faults=(),
        stopped=False,
        moving=moving,
    )


def reading_of(order: ArmOrder, samples_rad: ArrayLike, *, first_sample: int) -> Reading:
    """Return mean and standard deviation of k samples of n joints (k, n), rad. `first_sample`: number of the first."""
    samples = np.asarray(samples_rad, dtype=float)
    mean = samples.mean(axis=0)
    scales = [joint.scale for joint in order.description.joints]
    counts = [scale.counts_of(q) for scale, q in zip(scales, mean.tolist(), strict=True)]
    spread = samples.std(axis=0, ddof=1) if len(samples) > 1 else np.zeros(len(mean))
    return Reading(
        mean_counts=frozen(counts),
        mean_rad=frozen(mean),
        sd_rad=frozen(spread),
        samples=len(samples),
        first_sync=first_sample,
    )


class SimulatedChain:
    """A simulated arm with its tool in a fixture: joints in position mode drive the arm, free joints follow.

    >>> chain = SimulatedChain(arm="sarcos_dextrous", fixture="hinge", seed=0)
    >>> chain.step([None] * 7, chain.angles_rad).shape
    (7,)

    Parameters
    ----------
    arm, fixture
        Files, or names of built-in files.
    seed
        Seed of the true geometry, which is drawn at random within the tolerances of the files.
    scenario
        Scenario of the arm's errors, as in `sarcal --scenario`.

    Attributes
    ----------
    angles_rad
        Sensor readings (n,) after the last step.
    torques_nm
        Joint torques (n,), N m, after the last step.
    """

    def __init__(
        self,
        *,
        arm: str | Path,
        fixture: str | Path,
        seed: int = 0,
        scenario: str = DEFAULT_SCENARIO,
    ) -> None:
        model = load_arm(str(arm))
        chosen = virtual_arm(
            model, load_fixture(str(fixture)), Choices(scenario=scenario, seed=seed)
        )
        self._plant = chosen.build(model)
        self._resolution_rad = [sensor.resolution_rad for sensor in self._plant.sensors]
        self.angles_rad: FloatArray = frozen([0.0] * model.joint_count)
        self.torques_nm: FloatArray = self.angles_rad
        self.step([None] * model.joint_count, self.angles_rad)

    def step(self, modes: Sequence[JointMode | None], targets_rad: FloatArray) -> FloatArray:
        """Simulate 10 ms and return the sensor readings (n,), rad.

        `modes`: one per joint, None if the drive is off and the joint blocked. `targets_rad` (n,): for position mode.
        """
        reading = self._plant.step(list(zip(modes, map(float, targets_rad), strict=True)))
        self.angles_rad = frozen(np.multiply(reading.position_counts, self._resolution_rad))
        self.torques_nm = frozen(reading.torque_nm)
        return self.angles_rad
