"""The transports under contract. A new one joins here by one line, and every contract runs over it.

``socketcan`` takes part where there is a vcan0; `test_socketcan_uml` brings one along.
"""

import itertools
import os
from collections.abc import Callable
from pathlib import Path

_numbers = itertools.count()


def _own_channel() -> str:
    return f"contract-{os.getpid()}-{next(_numbers)}"


TRANSPORTS: dict[str, Callable[[], str]] = {"virtual": _own_channel, "loopback": _own_channel}
"""Interface name, and what gives a test a channel of its own."""
if Path("/sys/class/net/vcan0").exists():
    TRANSPORTS["socketcan"] = lambda: "vcan0"
