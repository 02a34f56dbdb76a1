"""Errors of the workflow, each with a message and a remedy."""

from pathlib import Path

COMMAND_WORDS = ("pip ", "sarcal ")


class SessionError(Exception):
    """An error that the operator can act on: what happened, and the remedy."""

    def __init__(self, happened: str, remedy: str) -> None:
        self.happened = happened
        self.remedy = remedy
        # A remedy begins with a capital letter, unless it is a command to type.
        if not remedy.startswith(COMMAND_WORDS):
            remedy = remedy[:1].upper() + remedy[1:]
        super().__init__(f"{happened}. {remedy}." if remedy else f"{happened}.")

    def preceded_by(self, earlier: str) -> None:
        """Put a message about an earlier event in front of this error's message."""
        self.happened = f"{earlier.removesuffix('.')}. Then: {self.happened}"
        (own,) = self.args
        self.args = (f"{earlier.removesuffix('.')}. Then: {own}",)


class DrivesNotOffError(SessionError):
    """After the release of the arm, drives were still powered, or the arm did not answer the hold command.

    `powered`: joints whose drives reported that they are powered; empty if the arm did not answer.
    """

    def __init__(self, powered: tuple[int, ...]) -> None:
        self.powered = powered
        if powered:
            joints = ", ".join(map(str, powered))
            drives = f"the drives of joints {joints} are"
            if len(powered) == 1:
                drives = f"the drive of joint {joints} is"
            super().__init__(
                f"{drives} still powered after the release of the arm",
                "keep clear of the arm and its fixture, and switch off its power with the hardware stop; then find "
                "the cause",
            )
            return
        super().__init__(
            "the arm did not answer the hold command at its release: its state is not known",
            "look before you go near: only drives that have power and monitor the heartbeat (1016h, 6007h) hold by "
            "themselves",
        )


class GuardError(SessionError):
    """The conditions of an operation are not met; nothing was done."""


class ClosureRefusedError(GuardError):
    """The joint readings do not close the loop; no drive was enabled.

    `probability`: p-value of the chi2 test of the readings; None if another check refused them.
    """

    def __init__(self, happened: str, remedy: str, *, probability: float | None = None) -> None:
        super().__init__(happened, remedy)
        self.probability = probability


class ConnectAgainError(ClosureRefusedError):
    """The joint readings are wrong: the cause must be corrected at the arm before connecting again."""


class Cancelled(SessionError):
    """The operator cancelled the task; the arm has come to rest."""

    def __init__(self) -> None:
        super().__init__("Ended by the operator", "The arm holds; go on when you are ready")


class JournalError(SessionError):
    """A session's journal cannot be read, written or locked."""


class JournalDamagedError(JournalError):
    """A complete line of a journal was changed, or its data are not valid."""

    def __init__(self, *, path: Path, line: int, problem: str) -> None:
        self.path, self.line, self.problem = path, line, problem
        super().__init__(
            f"{path} is damaged at line {line}: {problem}",
            f"restore the file from a copy, or keep the valid lines with: sarcal session repair "
            f"{path.parent}",
        )


class JournalForeignError(JournalError):
    """The file is not a journal, or has an unknown version."""


class JournalLostError(JournalError):
    """The journal was deleted, moved, replaced or changed while a session was using it.

    `rescued`: folder of a new session that has all entries of the journal; None if it could not be created.
    """

    def __init__(self, happened: str, remedy: str, *, rescued: Path | None) -> None:
        self.rescued = rescued
        super().__init__(happened, remedy)
