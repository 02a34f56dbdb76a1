"""Errors of the workflow, each with what happened and what to do now. Knows no screen."""

from __future__ import annotations

from pathlib import Path

COMMANDS = ("pip ", "sarcal ")


def _as_sentence(remedy: str) -> str:
    """With a capital, unless it begins with what is to be typed."""
    return remedy if remedy.startswith(COMMANDS) else remedy[:1].upper() + remedy[1:]


class SessionError(Exception):
    """Something the operator has to know and can act on.

    Attributes
    ----------
    happened, remedy
        One sentence each: what happened, what to do now.
    """

    def __init__(self, happened: str, remedy: str) -> None:
        self.happened = happened
        self.remedy = remedy
        super().__init__(f"{happened}. {_as_sentence(remedy)}." if remedy else f"{happened}.")

    def preceded_by(self, told: str) -> None:
        """Say first what had happened before."""
        self.happened = f"{told.removesuffix('.')}. Then: {self.happened}"
        (said,) = self.args
        self.args = (f"{told.removesuffix('.')}. Then: {said}",)


class NotLetGoError(SessionError):
    """An arm was let go of, and is not known to be left as it should be: held, its drives off.

    Attributes
    ----------
    powered
        Joints whose drives said that they were powered still; empty where the arm did not answer.
    """

    def __init__(self, powered: tuple[int, ...]) -> None:
        self.powered = powered
        if powered:
            joints = ", ".join(map(str, powered))
            drives = (
                f"the drive of joint {joints} is"
                if len(powered) == 1
                else f"the drives of joints {joints} are"
            )
            super().__init__(
                f"{drives} still powered: letting go of the arm did not switch that off",
                "keep clear of the arm and of its fixture, and take its power by the hardware stop; only then "
                "find out why",
            )
            return
        super().__init__(
            "the arm did not answer when it was told to hold and let go: nobody here knows what it does",
            "look before you go near; its drives hold by themselves when they miss the operator's heartbeat",
        )


class GuardError(SessionError):
    """A step was asked for before its conditions hold; nothing was done."""


class StandingRefusedError(GuardError):
    """Where the arm stands, what it reads cannot be; no drive was enabled.

    Attributes
    ----------
    probability
        Chance of readings that fit worse in an arm that is as known; None where another thing told.
    """

    def __init__(self, happened: str, remedy: str, *, probability: float | None = None) -> None:
        super().__init__(happened, remedy)
        self.probability = probability


class ConnectAgainError(StandingRefusedError):
    """What the arm reads cannot be: that is mended at the arm, which is then connected again."""


class Cancelled(SessionError):
    """The operator ended what was under way; the arm has come to rest."""

    def __init__(self) -> None:
        super().__init__("Ended by the operator", "The arm holds; go on when you are ready")


class JournalError(SessionError):
    """A session's journal cannot be read, written or locked."""


class JournalExistsError(JournalError):
    """Where a journal was to begin there is one."""


class JournalDamagedError(JournalError):
    """A complete line of a journal is not what was written, or says what no session can mean.

    Attributes
    ----------
    path, line, key
        Where; the key is empty where the line as a whole is meant.
    problem
        What is wrong with it, in words.
    events
        How many lines before it are whole.
    """

    def __init__(self, *, path: Path, line: int, problem: str, events: int, key: str = "") -> None:
        self.path, self.line, self.key = path, line, key
        self.problem, self.events = problem, events
        super().__init__(
            f"{path} is damaged at line {line}: {problem}",
            f"restore the file from a copy, or keep what can be proven with: sarcal session repair "
            f"{path.parent}",
        )


class JournalForeignError(JournalError):
    """A file in a journal's place that is none, or of a version that is not known here."""


class JournalLostError(JournalError):
    """The journal was taken away, replaced or changed while a session was writing it.

    Attributes
    ----------
    rescued
        Folder of a new session that holds everything, the last entry included; None where it could
        not be written.
    """

    def __init__(self, happened: str, remedy: str, *, rescued: Path | None) -> None:
        self.rescued = rescued
        super().__init__(happened, remedy)
