"""Fuzzing of every parser and of the bus: valid inputs with random mutations, by seed.

An input is accepted, or refused with an expected error; any other exception is a defect and is raised.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

from operator_app.exit_codes import EXPECTED_ERRORS
from tests.oracles.bus_fuzzing import FuzzedOperator
from tests.oracles.command_fuzzing import fuzz_command
from tests.oracles.document_fuzzing import DOCUMENTS
from tests.oracles.input_mutations import Refused
from tests.oracles.path_fuzzing import fuzz_instrument, fuzz_parameter_slots

_operator = FuzzedOperator()
over = _operator.close
PARSERS: Mapping[str, Callable[[Random, Path], None]] = {
    **DOCUMENTS,
    "arguments": fuzz_command,
    "instrument": fuzz_instrument,
    "parameter slots": fuzz_parameter_slots,
    "the wire": lambda rng, _: _operator.fuzz(rng),
}


def outcome(kind: str, seed: int, folder: Path) -> str:
    """Outcome of one input: ``accepted`` or ``refused``."""
    rng = Random(f"{kind} {seed}")  # noqa: S311 - to be repeated, not to be secret
    try:
        PARSERS[kind](rng, folder)
    except (*EXPECTED_ERRORS, Refused):
        return "refused"
    return "accepted"
