"""Simulated tracker of the virtual open arm, with the line protocol of instruments.

The answer to ``{"measure": "12"}`` is ``{"pose": "12", "x_m": ..., ..., "rz_deg": ...}``: position of the target in the
tracker's own frame, and orientation as a rotation vector.
"""

import json
import math
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from fixtures.measured import Measured
from hardware.errors import InstrumentError
from hardware.virtual.plant import Plant
from solver.arrays import FloatArray
from solver.chain.rotations import rotation_matrix, rotation_vector
from solver.loops.endpoints import MeasuredClosure

ENDPOINT_FIELDS = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")


class SimulatedTracker:
    """Simulated instrument: measures the target on the tool of `plant`, an open arm with the closure model `loop`.

    With `noise`, the measurements have the standard deviations of `instrument`; otherwise they are exact.
    """

    def __init__(
        self,
        plant: Plant,
        loop: MeasuredClosure,
        instrument: Measured,
        *,
        noise: bool,
        rng: np.random.Generator,
    ) -> None:
        self._plant, self._loop, self._instrument = plant, loop, instrument
        self._noise, self._rng = float(noise), rng
        self._one_at_a_time = threading.Lock()

    def measured(self) -> FloatArray:
        """Return the measured position (3,), m; for a full pose, position and rotation vector (rad), shape (6,)."""
        with self._one_at_a_time:
            draw = self._noise * self._rng.standard_normal(6)
        q_rad = self._plant.true_angles_rad[1:] - self._plant.truth.offsets_rad
        (position,), (rotation,) = self._loop.predicted(np.zeros(0), q_rad[None])
        position = position + self._instrument.sigma_m * draw[3:]
        if not self._instrument.full_pose:
            return np.asarray(position)
        rotation_seen = rotation_matrix(self._instrument.sigma_rad * draw[:3]) @ rotation
        return np.concatenate((position, rotation_vector(rotation_seen)))

    def answer(self, question: str) -> str:
        """Return the answer to a request line; for an invalid request, an error that shows a valid request."""
        try:
            pose = str(json.loads(question)["measure"])
        except (ValueError, TypeError, KeyError, RecursionError):
            return json.dumps({"error": 'ask {"measure": "12"} for a measurement of pose 12'})
        position = self.measured().tolist()
        position[3:] = map(math.degrees, position[3:])
        return json.dumps({"pose": pose, **dict(zip(ENDPOINT_FIELDS, position, strict=False))})


HOST, TRACKER_PORT = "127.0.0.1", 7327
"""Default address and TCP port of the simulated tracker, which only this machine can reach."""
LONGEST_QUESTION = 4096
"""Largest length of a question, bytes; a longer question closes the connection."""
CLIENTS = 16
"""Largest number of simultaneous clients, one thread each; a further client gets an error and is disconnected."""


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = CLIENTS

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._places = threading.BoundedSemaphore(CLIENTS)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
            return
        full = f"{CLIENTS} programs are connected, the largest number allowed: end one of them"
        with suppress(OSError):
            request.sendall(json.dumps({"error": full}).encode() + b"\n")
        self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()


@contextmanager
def serve_tracker(answer: Callable[[str], str], port: int = TRACKER_PORT) -> Iterator[int]:
    """Context in which every line received on `port` (0: any free port) is answered; yields the port number.

    Raises `InstrumentError` if another program listens on that port.
    """

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while True:
                try:
                    question = self.rfile.readline(LONGEST_QUESTION)
                    if not question.endswith(b"\n"):
                        return
                    self.wfile.write(answer(question.decode(errors="replace")).encode() + b"\n")
                except OSError:  # the client disconnected
                    return

    try:
        server = _Server((HOST, port), Handler)
    except OSError as error:
        raise InstrumentError(
            f"the tracker cannot listen at {HOST}:{port} ({error.strerror or error}): another program does, "
            "perhaps another controller. End that, or use another port: --tracker-port N here, and --tracker "
            f"tcp:{HOST}:N in the session"
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
