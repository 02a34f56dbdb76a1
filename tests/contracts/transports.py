"""The transports under contract: every contract runs on each.

``socketcan`` needs a vcan0, which `test_socketcan_uml` provides.
"""

import itertools
import os
from collections.abc import Callable
from pathlib import Path

_numbers = itertools.count()


def _own_channel() -> str:
    return f"contract-{os.getpid()}-{next(_numbers)}"


TRANSPORTS: dict[str, Callable[[], str]] = {"virtual": _own_channel, "loopback": _own_channel}
"""Function that returns a new channel, by interface."""
if Path("/sys/class/net/vcan0").exists():
    TRANSPORTS["socketcan"] = lambda: "vcan0"
