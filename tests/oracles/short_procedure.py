"""A packaged procedure with few poses, for the arm of a scenario."""

from dataclasses import replace

from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure


def short_procedure(
    poses: int, name: str = "exact", *, packaged: str = "hinge", seed: int = 0, samples: int = 8
) -> Procedure:
    """The procedure with `poses` poses of `samples` samples, for the arm of scenario `name`."""
    procedure = load_procedure(packaged)
    return replace(
        procedure,
        arm=scenario(name, seed).arm(procedure.arm),
        capture=replace(procedure.capture, poses=poses, samples_per_pose=samples),
    )
