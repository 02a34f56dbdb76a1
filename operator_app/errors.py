"""Errors of the workflow, each with what happened and what to do now. Knows no screen."""

from __future__ import annotations


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
        super().__init__(f"{happened}. {remedy}." if remedy else f"{happened}.")


class GuardError(SessionError):
    """A step was asked for before its conditions hold; nothing was done."""


class Cancelled(SessionError):
    """The operator ended what was under way; the arm has come to rest."""

    def __init__(self) -> None:
        super().__init__("Ended by the operator", "The arm holds; go on when you are ready")


class JournalError(SessionError):
    """A session's journal cannot be read, written or locked."""
