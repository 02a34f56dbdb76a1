"""What a solving process may be asked in tests: module-level, because it is named and not sent."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from solver.errors import SolverError, UnidentifiableDirection, UnidentifiableError


def surroundings(path: str) -> dict[str, object]:
    """What the process has loaded and holds open, and what it is."""
    return {
        "pid": os.getpid(),
        "session": os.getsid(0),
        "modules": sorted(sys.modules),
        # The list itself is open while it is read.
        "open": [str(fd.readlink()) for fd in Path("/proc/self/fd").iterdir() if fd.is_symlink()],
        "given": path,
    }  # fmt: skip


def count(to: int, progress: Callable[[int, float], None]) -> int:
    """Say each number."""
    for k in range(to):
        progress(k, float(k))
    return to


def never(mark: str, progress: Callable[[int, float], None]) -> None:
    """Say the process once, then do not end."""
    Path(mark).write_text(str(os.getpid()), "utf-8")
    progress(os.getpid(), 0.0)
    threading.Event().wait()


def refuse() -> None:
    """What the poses cannot give."""
    raise SolverError("these poses say nothing")


def cannot_tell(name: str) -> None:
    """What the poses leave open, with its facts."""
    direction = UnidentifiableDirection(parameters=(name,), weights=(1.0,))
    raise UnidentifiableError((direction,), note="one note")


def turn() -> tuple[int, int]:
    """Return how this process is scheduled, and how nice it is."""
    return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)


def break_down() -> None:
    """A defect."""
    raise ZeroDivisionError("by zero")


def die(how: str) -> None:
    """End as the operating system ends a process."""
    if how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    os._exit(7)
