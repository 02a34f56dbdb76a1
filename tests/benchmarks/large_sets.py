"""Large pose sets with a fault, through `sarcal solve`: is the cause named, how soon, in how much memory; a table.

    python tests/benchmarks/large_sets.py [--poses 300,1000,3000,10000] [--faults slips,odd] [--seed 1] [--checks]

Every set is a session of one arm with every source of error at its stated size, and one fault. The command runs as
a process of its own; seconds are the processor's, megabytes the peak of its memory. Bars: an answer or a reason in
ten seconds, below 600 MB, no traceback, the right cause first, and nothing accepted that is wrong.
"""

# ruff: noqa: T201 - a benchmark prints

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from tests.oracles.shop_floor import Session
from tests.oracles.shop_floor_large import LARGE_FAULTS, large

LIMIT_S, LIMIT_MB = 10.0, 600.0
START = "import sys; from operator_app.cli import main; sys.exit(main())"


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What the command said: exit code, codes of its causes, processor's seconds, peak of memory."""

    code: int
    causes: tuple[str, ...]
    said: str
    seconds: float
    megabytes: float


def answered(found: Session, file: Path, *options: str) -> Answer:
    """Solve a session as a user does."""
    file.write_text(found.csv())
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    out, err = file.with_suffix(".out"), file.with_suffix(".err")
    with out.open("w") as stdout, err.open("w") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-c", START, "solve", str(file), "--json", *options],
            stdout=stdout,
            stderr=stderr,
            env=os.environ | single,
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    said, complaint = out.read_text(), err.read_text()
    return Answer(
        code=process.returncode,
        causes=_causes(said, complaint),
        said=complaint or said,
        seconds=used.ru_utime + used.ru_stime,
        megabytes=used.ru_maxrss / 1024.0,
    )


def _causes(said: str, complaint: str) -> tuple[str, ...]:
    try:
        document = json.loads(said)
    except ValueError:
        return ("TRACEBACK",) if "Traceback" in complaint else (complaint.strip()[:100],)
    causes = document.get("causes")
    if causes is None:
        return (str(document.get("code", document.get("error", ""))),)
    return tuple(cause["code"] for cause in causes)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sets and print what came of them; 0 when every bar is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", default="300,1000,3000,10000")
    parser.add_argument("--faults", default="", help="parts of names, separated by commas")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--checks", action="store_true", help="with --checks as well")
    parser.add_argument("--words", action="store_true", help="print what was said")
    options = parser.parse_args(arguments)
    more = ("--checks",) if options.checks else ()
    missed = 0
    print(f"{'fault':24}{'poses':>7}{'s':>7}{'MB':>6}{'exit':>5}  causes")
    with tempfile.TemporaryDirectory() as folder:
        for count in (int(n) for n in options.poses.split(",")):
            sound = large(options.seed, count)
            for name, (fault, right) in LARGE_FAULTS.items():
                if not any(part in name for part in options.faults.split(",")):
                    continue
                found = fault(sound)
                answer = answered(found, Path(folder) / "poses.csv", *more)
                bad = _missed(answer, right)
                missed += bool(bad)
                print(
                    f"{name:24}{count:7}{answer.seconds:7.1f}{answer.megabytes:6.0f}{answer.code:5}  "
                    f"{', '.join(answer.causes[:4])}{'   MISSED ' + bad if bad else ''}",
                    flush=True,
                )
                if options.words:
                    print(answer.said)
    return 1 if missed else 0


def _missed(answer: Answer, right: str) -> str:
    first = answer.causes[0] if answer.causes else ""
    wrong = {
        "cause": re.fullmatch(right, first) is None,
        "accepted": bool(right) and answer.code == 0 and not re.fullmatch(right, first),
        "time": answer.seconds > LIMIT_S,
        "memory": answer.megabytes > LIMIT_MB,
    }
    return " ".join(what for what, yes in wrong.items() if yes)


if __name__ == "__main__":
    sys.exit(main())
