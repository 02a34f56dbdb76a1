"""Mutation tests of the modules of command limits and CiA 402. Needs the extra 'mutation'.

    python -m tests.mutation [MODULE ...] [--processes 2]

The module's own tests run on each of its mutants until one fails. Mutants that no test detects must be in
``survivors.toml`` beside this file, with the reason why they are no faults; any other survivor, and any reason
without its survivor, is exit code 1.
"""

import argparse
import os
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

os.environ["CI"] = "1"  # hypothesis: the same examples for all mutants, and no files

from tests.mutation.mutant_run import passed, start_tests
from tests.mutation.mutants import Mutant, mutants_of

ROOT = Path(__file__).parents[2]
TESTS = {
    "hardware/command_limits.py": ["tests/hardware/test_command_limits.py"],
    "hardware/canopen/cia402.py": ["tests/hardware/canopen/test_cia402.py"],
    "hardware/monitors/admission.py": ["tests/hardware/monitors/test_admission.py"],
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("modules", nargs="*", default=list(TESTS), metavar="MODULE")
    parser.add_argument("--processes", type=int, default=1)
    args = parser.parse_args()
    if unknown := set(args.modules) - set(TESTS):
        parser.error(f"unknown modules: {', '.join(sorted(unknown))}; known: {', '.join(TESTS)}")
    failed = False
    for module in args.modules:
        source = (ROOT / module).read_text()
        if not passed(start_tests(ROOT, module, source, TESTS[module])):
            print(f"{module}: its tests fail without a mutant")
            return 2
        start_s = time.monotonic()
        mutants = list(mutants_of(source))
        survivors = [m for m, survived in _test(module, mutants, args.processes) if survived]
        reasons = _reasons(module)
        print(
            f"{module}: {len(mutants)} mutants, {len(mutants) - len(survivors)} detected, "
            f"{time.monotonic() - start_s:.0f} s"
        )
        for mutant in survivors:
            reason = reasons.pop(mutant.change, None)
            print(
                f"  line {mutant.line}: {mutant.change}\n    {reason or 'NOT DETECTED, NO REASON'}"
            )
            failed |= reason is None
        for change in sorted(reasons):
            print(f"  has a reason, but is detected or no longer a mutant: {change}")
            failed = True
    return int(failed)


def _test(module: str, mutants: Iterable[Mutant], processes: int) -> Iterator[tuple[Mutant, bool]]:
    running: list[tuple[Mutant, int]] = []
    for mutant in mutants:
        if len(running) >= processes:
            first, pid = running.pop(0)
            yield first, passed(pid)
        running.append((mutant, start_tests(ROOT, module, mutant.source, TESTS[module])))
    for mutant, pid in running:
        yield mutant, passed(pid)


def _reasons(module: str) -> dict[str, str]:
    """Return why a mutant is no fault, by its change."""
    groups = tomllib.loads(Path(__file__).with_name("survivors.toml").read_text()).get(module, [])
    return {change: group["why"] for group in groups for change in group["changes"]}


if __name__ == "__main__":
    sys.exit(main())
