"""A packaged procedure made short for a test, of the arm that a scenario carries."""

from dataclasses import replace

from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure


def short_procedure(
    poses: int, name: str = "exact", *, packaged: str = "hinge", seed: int = 0, samples: int = 8
) -> Procedure:
    """Return the procedure with so many poses, of so many samples each, for the arm of scenario `name`."""
    found = load_procedure(packaged)
    return replace(
        found,
        arm=scenario(name, seed).arm(found.arm),
        capture=replace(found.capture, poses=poses, samples_per_pose=samples),
    )
