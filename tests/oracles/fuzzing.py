"""Inputs that nobody would write, for every parser and for the wire: sound ones changed at random, seed by seed.

An outcome is an answer or one of the errors that `sarcal` turns into words and an exit code; whatever
else comes out is a defect and is left to be raised.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

from operator_app.exit_codes import EXPECTED_ERRORS
from tests.oracles.command_fuzzing import run_nearly
from tests.oracles.document_fuzzing import DOCUMENTS
from tests.oracles.odd_input import Refused
from tests.oracles.place_fuzzing import ask_instrument, keep_slots
from tests.oracles.wire_fuzzing import Target

_target = Target()


def _wire(rng: Random, _: Path) -> None:
    _target.meddle(rng)


def over() -> None:
    """Let go of the operator that still runs, if it does."""
    _target.close()


PARSERS: Mapping[str, Callable[[Random, Path], None]] = {
    **DOCUMENTS,
    "arguments": run_nearly,
    "instrument": ask_instrument,
    "parameter slots": keep_slots,
    "the wire": _wire,
}


def outcome(kind: str, seed: int, folder: Path) -> str:
    """What comes of one input: ``accepted`` or ``refused``; a defect is raised."""
    rng = Random(f"{kind} {seed}")  # noqa: S311 - to be repeated, not to be secret
    try:
        PARSERS[kind](rng, folder)
    except (*EXPECTED_ERRORS, Refused):
        return "refused"
    return "accepted"
