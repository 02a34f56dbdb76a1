"""Jobs of a solver process for tests; module-level, because a job is sent by its name."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from solver.errors import UnidentifiableDirection, UnidentifiableError


def process_state() -> dict[str, object]:
    """Identity, loaded modules and open files of the process."""
    return {
        "pid": os.getpid(),
        "session": os.getsid(0),
        "modules": sorted(sys.modules),
        # The directory itself is open while it is listed.
        "open": [str(fd.readlink()) for fd in Path("/proc/self/fd").iterdir() if fd.is_symlink()],
    }  # fmt: skip


def count(to: int, progress: Callable[[int, float], None]) -> int:
    for k in range(to):
        progress(k, float(k))
    return to


def never(mark: str, progress: Callable[[int, float], None]) -> None:
    """Report the process's number once, then do not end."""
    Path(mark).write_text(str(os.getpid()), "utf-8")
    progress(os.getpid(), 0.0)
    threading.Event().wait()


def fail_unidentifiable(name: str) -> None:
    direction = UnidentifiableDirection(parameters=(name,), weights=(1.0,))
    raise UnidentifiableError((direction,), note="one note")


def turn() -> tuple[int, int]:
    """Return the scheduling policy and the nice value of this process."""
    return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)


def fail_with_defect() -> None:
    raise ZeroDivisionError("by zero")


def die(how: str) -> None:
    """Die by a signal, or exit without cleanup."""
    if how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    os._exit(7)
