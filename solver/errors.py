"""Errors of the solver, with the facts that a caller needs to explain them."""

from dataclasses import dataclass


class SolverError(Exception):
    """Base of the solver's errors. A fit that does not converge does not raise an error."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle by attributes instead of constructor arguments: the error may come from another process."""
        return Exception.__new__, (type(self), *self.args), self.__dict__


@dataclass(frozen=True, slots=True, kw_only=True)
class UnidentifiableDirection:
    """A direction in parameter space that the pose set does not determine.

    `parameters`: names of the parameters that change along the direction, the one with the largest weight first.
    `weights`: components of these parameters in the direction's unit vector, for a Jacobian with scaled columns.
    `reason`: text that states why the direction is undetermined ("joint 4 does not move"); empty if unknown.
    `immobile_joints`: joints (1-based) of this direction whose readings hardly change over the pose set.
    """

    parameters: tuple[str, ...]
    weights: tuple[float, ...]
    reason: str = ""
    immobile_joints: tuple[int, ...] = ()

    def __str__(self) -> str:
        head, *rest = self.parameters
        text = f"{head} cannot be determined"
        if rest:
            text = f"{head} cannot be separated from {', '.join(rest)}"
        return f"{text}: {self.reason}" if self.reason else text


class UnidentifiableError(SolverError):
    """The pose set leaves some parameters undetermined; `directions` names them.

    `code` and `note` state the reason if it is known: too few poses, or the stuck sensor of joint `stuck_joint`
    (1-based; 0: no stuck sensor).
    """

    def __init__(
        self,
        directions: tuple[UnidentifiableDirection, ...],
        *,
        code: str = "UNIDENTIFIABLE",
        note: str = "",
        stuck_joint: int = 0,
    ) -> None:
        self.directions = directions
        self.code = code
        self.note = note
        self.stuck_joint = stuck_joint
        listed = "; ".join(str(direction) for direction in directions)
        super().__init__(f"{listed}; {note}" if note else listed)


class PosesDoNotFitError(SolverError):
    """The readings are so far from closing a loop that the loop cannot be linearised about them.

    `reasons`, `codes`: texts and codes of the mistakes that would explain the misfit, the most probable first.
    """

    def __init__(self, reasons: tuple[str, ...] = (), *, codes: tuple[str, ...] = ()) -> None:
        self.code = codes[0] if codes else "POSES_DO_NOT_FIT"
        super().__init__(
            "these poses do not fit this arm in this fixture at all: "
            + (
                "; or ".join(reasons)
                or "check that arm, fixture and poses belong together, or try --global-start"
            )
        )


class TooFewPosesError(SolverError):
    """There are fewer equations than unknowns, or no degree of freedom is left to test the fit."""

    code = "TOO_FEW_POSES"

    def __init__(
        self, *, poses: int, needed: int, parameters: int, equations_per_pose: int
    ) -> None:
        self.poses = poses
        self.needed = needed
        if equations_per_pose <= 0:
            text = "with so many joints unsensed a pose gives no equation: use the readings of more joints"
        else:
            text = (
                f"{poses} pose{'s give' if poses != 1 else ' gives'} {poses * equations_per_pose} "
                f"equations for {parameters} parameters; at least {needed} poses are needed to solve for them, and "
                "about 20 for a diagnosis"
            )
        super().__init__(text)
