"""Runs a calibration in a separate process, which does not delay bus and screen and can be killed.

The process uses neither bus nor terminal, and ends whenever its parent ends. This module contains both ends of the
pipe between the two processes.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeVar

from hardware.timing import normal_priority
from operator_app.errors import SessionError

if TYPE_CHECKING:
    from solver.estimators.least_squares import Progress

T = TypeVar("T")

PROCESS_POLL_S = 0.02
"""Interval between calls of `SolvingProcess.go_on`, which may end the calculation."""
NICENESS = 5
"""Increment of the niceness of the process: screen and bus have priority."""
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Solver(Protocol):
    """Calls a long computation, such as a calibration, in this process (`solve_here`) or another (`SolvingProcess`)."""

    def __call__(self, function: Callable[..., T], *args: object, **options: object) -> T:
        """Call `function` with these arguments and return its result."""


def solve_here(function: Callable[..., T], *args: object, **options: object) -> T:
    """Call `function` with these arguments in this process, and return its result."""
    return function(*args, **options)


class SolvingProcess:
    """A `Solver` in a separate process, which starts at the first call and ends with the ``with`` block.

    `go_on` is called every `PROCESS_POLL_S` and at each progress report; an exception that it raises ends the call.
    """

    def __init__(self, go_on: Callable[[], None] = lambda: None) -> None:
        self._go_on = go_on
        self._running: tuple[subprocess.Popen[bytes], Connection] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._running is not None:
            process, connection = self._running
            self._running = None
            process.kill()
            process.communicate()
            connection.close()

    def __call__(self, function: Callable[..., T], *args: object, **options: Any) -> T:
        """Call `function` in the other process and return its result; the option `progress` is called in this process.

        Raises SolverError if the function raised it, and SessionError if the function raised another exception or the
        process ended by itself.
        """
        process, connection = self._started()
        progress: Progress | None = options.pop("progress", None)
        try:
            connection.send((function, args, options, progress is not None))
            while True:
                self._go_on()
                if not connection.poll(PROCESS_POLL_S):
                    continue
                what, message = connection.recv()
                if what == "progress" and progress is not None:
                    progress(*message)
                elif what == "refused" and isinstance(message, Exception):
                    raise message
                elif what == "refused":
                    raise SessionError(*message)
                elif what == "found":
                    result: T = message
                    return result
        except (EOFError, OSError) as gone:
            code = process.wait()
            reason = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            raise SessionError(
                f"The solver process ended by itself ({reason})",
                "All poses are kept: calibrate again. If it happens again, close programs that use much memory",
            ) from gone

    def _started(self) -> tuple[subprocess.Popen[bytes], Connection]:
        if self._running is None:
            connection, other_end = Pipe()
            start = "from operator_app.session.store.solver_process import serve; serve()"
            command = [sys.executable, "-P", "-c", start, str(other_end.fileno())]
            process = subprocess.Popen(  # noqa: S603 - this interpreter, this module
                command,
                # When this process ends, the standard input of the child ends, and so does the child.
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[other_end.fileno()],
                # Ctrl-C and a closed terminal must not send a signal to the child.
                start_new_session=True,
                env=os.environ
                | dict.fromkeys(THREADS, "1")
                | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
            other_end.close()
            self._running = process, connection
        return self._running


# -- the other end ---------------------------------------------------------------------------------


def serve() -> None:
    """Run the functions received through the pipe until the other end of the pipe is closed."""
    normal_priority()  # drop the real-time priority inherited from the process that drives the arm
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(NICENESS)
    connection: Connection = Connection(int(sys.argv[1]))
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, args, options, wants_progress = connection.recv()
            if wants_progress:
                options["progress"] = lambda *progress: connection.send(("progress", progress))
            connection.send(_answer(function, args, options))


def _answer(
    function: Callable[..., object], args: tuple[object, ...], options: dict[str, Any]
) -> tuple[str, object]:
    try:
        return "found", function(*args, **options)
    except Exception as error:  # noqa: BLE001 - reported at the other end
        from operator_app.messages.errors import EXPECTED, words
        from solver.errors import SolverError

        if isinstance(error, SolverError):  # can be pickled
            return "refused", error
        if isinstance(error, EXPECTED):
            text = words(error)
            return "refused", (text.happened, text.remedy)
        where = traceback.extract_tb(error.__traceback__)[-1]
        return "refused", (
            f"Program error: {error!r} in {where.name}, line {where.lineno} of {where.filename}",
            "All poses are kept in the session's folder: report the defect with that folder",
        )


def _end_with_parent() -> None:
    """End this process as soon as its standard input is closed, which happens when the parent process ends."""
    while os.read(0, 1):
        pass
    os._exit(1)
