"""Records a bus beside whoever uses it, by a handle and in a thread of its own. Sends nothing; knows no node."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hardware.buses.python_can import BusSettings, open_bus
from hardware.buses.shared_bus import SharedBus
from hardware.errors import BusError

_POLL_S = 0.05
"""How soon the end is noticed on a quiet bus."""


@contextmanager
def recorded(settings: BusSettings, path: Path) -> Iterator[Callable[[], str | None]]:
    """Record all that is said on a bus for as long as this is open; yields why it ended early, None if not.

    The end is told once this is closed. What is on its way then is still recorded.

    Raises
    ------
    BusError
        If the bus does not open once more, or the file cannot be begun.
    """
    wire = SharedBus(open_bus(settings), record_to=path)
    over, broken = threading.Event(), list[str]()

    def listen() -> None:
        try:
            while wire.receive(0.0 if over.is_set() else _POLL_S) is not None or not over.is_set():
                pass
        except (
            BusError
        ) as error:  # whoever uses the bus says so as well, and the file keeps what there was
            broken.append(str(error))

    thread = threading.Thread(target=listen, name="sarcal-recording", daemon=True)
    thread.start()
    try:
        yield lambda: wire.recording_failure or next(iter(broken), None)
    finally:
        over.set()
        thread.join(_POLL_S * 100)
        wire.close()
