"""The simulated tracker as a program of its own: a TCP port that answers lines. Knows no truth and no bus."""

from __future__ import annotations

import contextlib
import json
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hardware.errors import InstrumentError

HOST, PORT = "127.0.0.1", 7327
"""Where it listens unless told otherwise: this machine alone can ask it."""

LONGEST = 4096
"""Characters of a question; who sends more is hung up on."""


CLIENTS = 16
"""At one time, a thread each; one more is told so and hung up on."""


class _Server(socketserver.ThreadingTCPServer):
    """One thread a client; none keeps the program from ending."""

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = CLIENTS

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._places = threading.BoundedSemaphore(CLIENTS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Give it a thread, where there is one left."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
            return
        full = {"error": f"{CLIENTS} programs are connected, and no more may be: end one of them"}
        with contextlib.suppress(OSError):
            request.sendall(json.dumps(full).encode() + b"\n")
        self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer it, then leave its place to another."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()


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
