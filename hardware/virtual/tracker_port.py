"""TCP port of the simulated tracker: answers lines."""

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
"""Default address, reachable from this machine only."""
LONGEST = 4096
"""Largest length of a question, characters; the connection is closed beyond it."""
CLIENTS = 16
"""Simultaneous clients, one thread each; a further one gets an error and is disconnected."""


class _Server(socketserver.ThreadingTCPServer):
    """One daemon thread per client."""

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = CLIENTS

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._places = threading.BoundedSemaphore(CLIENTS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread if one is free."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
            return
        full = {"error": f"{CLIENTS} programs are connected, and no more may be: end one of them"}
        with contextlib.suppress(OSError):
            request.sendall(json.dumps(full).encode() + b"\n")
        self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve the client, then free its place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()


@contextmanager
def serve_tracker(
    answer: Callable[[str], str], port: int = PORT, *, host: str = HOST
) -> Iterator[int]:
    """Answer every line on `port` with a line; 0 takes any free port. Yields the port.

    Raises `InstrumentError` if another program listens there.
    """

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while True:
                try:
                    question = self.rfile.readline(LONGEST)
                    if not question.endswith(b"\n"):
                        return
                    reply = answer(question.decode(errors="replace"))
                    self.wfile.write(reply.encode() + b"\n")
                except OSError:  # the client disconnected
                    return

    try:
        server = _Server((host, port), Handler)
    except OSError as error:
        raise InstrumentError(
            f"the tracker cannot listen at {host}:{port} ({error.strerror or error}): another program does, "
            "perhaps another controller. End that, or use another port: --tracker-port N here, and --tracker "
            f"tcp:{host}:N in the session"
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
