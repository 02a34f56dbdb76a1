# ruff: noqa: T201 - prints what it found
"""Do the tests of the limits and of CiA 402 notice when these modules are wrong? Needs the extra 'mutation'.

    python -m tests.mutation [MODULE ...] [--processes 2]

Every mutant of a module is put in its place, one at a time, and the module's own tests run on it until
one fails. Those that no test notices have to be in ``survivors.toml`` beside this file, with the reason why
they are no faults; any other, and any reason without its survivor, is exit code 1.
"""

import argparse
import os
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

os.environ["CI"] = "1"  # hypothesis: the same examples for all mutants, and no files

from tests.mutation.mutants import Mutant, mutants_of
from tests.mutation.trial import Trial, begin, passes

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TESTS = {
    "hardware/command_limits.py": ["tests/hardware/test_command_limits.py"],
    "hardware/canopen/cia402.py": ["tests/hardware/canopen/test_cia402.py"],
    "hardware/monitors/admission.py": ["tests/hardware/monitors/test_admission.py"],
}


def main() -> int:
    """Try all mutants; say which no test notices."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("modules", nargs="*", default=list(TESTS), metavar="MODULE")
    parser.add_argument("--processes", type=int, default=1)
    args = parser.parse_args()
    if unknown := set(args.modules) - set(TESTS):
        parser.error(
            f"no tests are named for {', '.join(sorted(unknown))}; there are: {', '.join(TESTS)}"
        )
    failed = False
    for module in args.modules:
        source = (ROOT / module).read_text()
        if not passes(ROOT, module, source, TESTS[module]):
            print(f"{module}: its tests fail without a mutant")
            return 2
        began = time.monotonic()
        mutants = list(mutants_of(source))
        survivors = [m for m, noticed in _tried(module, mutants, args.processes) if not noticed]
        explained = _explained(module)
        print(
            f"{module}: {len(mutants)} mutants, {len(mutants) - len(survivors)} noticed, "
            f"{time.monotonic() - began:.0f} s"
        )
        for mutant in survivors:
            why = explained.get(mutant.change)
            print(
                f"  line {mutant.line}: {mutant.change}\n    {why or 'NOT NOTICED, NOT EXPLAINED'}"
            )
            failed |= why is None
        for change in sorted(set(explained) - {m.change for m in survivors}):
            print(f"  explained, but noticed or not made any more: {change}")
            failed = True
    return int(failed)


def _tried(module: str, mutants: Iterable[Mutant], processes: int) -> Iterator[tuple[Mutant, bool]]:
    """Each mutant and whether a test noticed it, in their order."""
    running: list[tuple[Mutant, Trial]] = []
    for mutant in mutants:
        if len(running) >= processes:
            first, trial = running.pop(0)
            yield first, not trial.passed()
        running.append((mutant, begin(ROOT, module, mutant.source, TESTS[module])))
    for first, trial in running:
        yield first, not trial.passed()


def _explained(module: str) -> dict[str, str]:
    """Why a mutant is no fault, by what it changes."""
    listed = tomllib.loads((HERE / "survivors.toml").read_text())
    return {change: group["why"] for group in listed.get(module, []) for change in group["changes"]}


if __name__ == "__main__":
    sys.exit(main())
