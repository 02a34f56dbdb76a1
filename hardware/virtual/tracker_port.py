"""The simulated tracker as a program of its own: a TCP port that answers lines. Knows no truth and no bus."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hardware.errors import InstrumentError

HOST, PORT = "127.0.0.1", 7327
"""Where it listens unless told otherwise: this machine alone can ask it."""

LONGEST = 4096
"""Characters of a question; who sends more is hung up on."""


class _Server(socketserver.ThreadingTCPServer):
    """One thread a client; none keeps the program from ending."""

    allow_reuse_address = True
    daemon_threads = True


@contextmanager
def serve_tracker(
    answer: Callable[[str], str], port: int = PORT, *, host: str = HOST
) -> Iterator[int]:
    """Answer every line that comes to `port` with a line; 0 takes any port that is free.

    Yields
    ------
    The port.

    Raises
    ------
    InstrumentError
        Somebody else listens there.
    """

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while True:
                try:
                    question = self.rfile.readline(LONGEST)
                    if not question.endswith(b"\n"):
                        return
                    said = answer(question.decode(errors="replace"))
                    self.wfile.write(said.encode() + b"\n")
                except OSError:
                    # The other end is gone: nobody to answer.
                    return

    try:
        server = _Server((host, port), Handler)
    except OSError as error:
        raise InstrumentError(
            f"the tracker cannot listen at {host}:{port} ({error.strerror or error}): another program does, "
            "perhaps another controller. End that, or take another port: --tracker-port N, and --tracker "
            f"tcp:{host}:N for who asks it"
        ) from error
    thread = threading.Thread(
        target=server.serve_forever, args=(0.05,), name="sarcal-tracker", daemon=True
    )
    thread.start()
    try:
        yield int(server.server_address[1])
    finally:
        server.shutdown()
        server.server_close()
        thread.join(5.0)
