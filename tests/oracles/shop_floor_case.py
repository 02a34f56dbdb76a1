"""A session of the shop floor with a fault: what would be a true statement about it. Knows nothing of who judges."""

from dataclasses import dataclass, field

from tests.oracles.shop_floor import PARAMETERS, Session


@dataclass(frozen=True, kw_only=True)
class Case:
    """A session with a fault.

    Attributes
    ----------
    causes
        Patterns (regular expressions, whole code) of which any names the fault.
    judged
        Parameters that have a truth still.
    either
        Another value that is as true, by name: a joint's offset before and after its counts slipped.
    nominal
        What the operator wrote into his arm and fixture files instead of what is shipped, by entry.
    harmless
        Whether the fault is within what the files state: to be survived, not found.
    """

    taken: Session
    causes: tuple[str, ...]
    judged: tuple[str, ...] = PARAMETERS
    either: dict[str, float] = field(default_factory=dict)
    nominal: dict[str, float] = field(default_factory=dict)
    harmless: bool = False
