"""Wrong and damaged pose files through `sarcal solve`: always an answer or a reason, and soon; a table.

    python tests/benchmarks/robust.py [--sets 500] [--processes 10] [--first 0]

Every set is a sound session, damaged in one to three ways, under options drawn at random. In-process
through the command's own `main`, a sample as real processes. Bars: no traceback, an exit code of the
contract, something said, ten seconds at most, JSON that reads back, and nonsense never accepted.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import contextlib
import io
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from operator_app.cli import main as sarcal
from tests.oracles.shop_floor_damage import Damaged, damaged

LIMIT_S = 10.0
"""Of the processor: the machine may be busy with other things."""

GIVE_UP_S = 120
CODES = (0, 2, 4, 5)
START = "import sys; from operator_app.cli import main; sys.exit(main())"


class TooLongError(Exception):
    """The command was still at it when nobody would have waited any longer."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What came of one set: `fault` is empty when nothing is wrong with it."""

    code: int
    seconds: float
    fault: str
    said: str


def _alarm(*_: object) -> None:
    raise TooLongError


def answered(found: Damaged, file: Path, *, process: bool) -> Answer:
    """Solve one set and look at the answer."""
    arguments = ["solve", str(file), *found.options]
    start, out, err = time.process_time(), io.StringIO(), io.StringIO()
    if process:
        began = _children_s()
        done = subprocess.run(
            [sys.executable, "-c", START, *arguments],
            capture_output=True,
            text=True,
            timeout=GIVE_UP_S,
            check=False,
        )
        code, said, complaint = done.returncode, done.stdout, done.stderr
        seconds = _children_s() - began
    else:
        signal.alarm(GIVE_UP_S)
        try:
            with (
                contextlib.redirect_stdout(out),
                contextlib.redirect_stderr(err),
                warnings.catch_warnings(),
            ):
                warnings.simplefilter("error")
                code = sarcal(arguments)
        except SystemExit as stop:
            code = int(stop.code or 0)
        except TooLongError:
            code = -2
            err.write("no answer")
        except Exception:  # noqa: BLE001 - whatever it is, it is what the benchmark is to count
            code = -1
            err.write(traceback.format_exc(limit=-3))
        finally:
            signal.alarm(0)
        said, complaint = out.getvalue(), err.getvalue()
        seconds = time.process_time() - start
    return Answer(
        code=code,
        seconds=seconds,
        fault=_fault(found, code, said, complaint, seconds),
        said=complaint or said,
    )


def _fault(found: Damaged, code: int, said: str, complaint: str, seconds: float) -> str:
    if "Traceback" in complaint:
        return "traceback"
    if code == -2 or seconds > LIMIT_S:
        return "too slow"
    if code not in CODES:
        return f"exit code {code}"
    if not (said.strip() or complaint.strip()):
        return "nothing said"
    if code == 0 and found.nonsense:
        return "nonsense accepted"
    if "--json" in found.options and code in (0, 4, 5):
        try:
            document = json.loads(said, parse_constant=_no_number)
        except ValueError:
            return "not JSON"
        if code == 0 and any(not s > 0.0 for s in document["sigma"].values()):
            return "a sigma of nothing"
    return ""


def _children_s() -> float:
    """Processor time of processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _no_number(text: str) -> None:
    raise ValueError(text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sets and print what came of them; 0 when every bar is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=10, help="sets run as real processes")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGALRM, _alarm)
    codes: Counter[int] = Counter()
    faults: list[tuple[int, Damaged, Answer]] = []
    slowest = (0.0, -1, ("",))
    every = max(options.sets // max(options.processes, 1), 1)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(options.first, options.first + options.sets):
            found = damaged(k)
            file = Path(folder) / "poses.csv"
            file.write_bytes(found.data)
            answer = answered(found, file, process=options.processes > 0 and k % every == 0)
            codes[answer.code] += 1
            slowest = max(slowest, (answer.seconds, k, found.ways))
            if answer.fault:
                faults.append((k, found, answer))
                print(
                    f"set {k}: {answer.fault}: {', '.join(found.ways)}; {' '.join(found.options)}"
                )
                print("\n".join(f"    {t}" for t in answer.said.splitlines()[-5:]), flush=True)
    print(f"{options.sets} sets; exit codes {dict(sorted(codes.items()))}")
    print(f"slowest {slowest[0]:.1f} s: set {slowest[1]}, {', '.join(slowest[2])}")
    print(f"faults {dict(Counter(a.fault for _, _, a in faults))}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
