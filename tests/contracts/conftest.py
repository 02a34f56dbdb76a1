"""The transports under contract; every contract runs on each. Imports no arm, as emulated machines are slow.

``socketcan`` needs a vcan0, which `test_socketcan_uml` provides.
"""

import os
from pathlib import Path

import pytest

from hardware.buses.python_can import BusSettings

INTERFACES = ["virtual", "loopback"]
if Path("/sys/class/net/vcan0").exists():
    INTERFACES.append("socketcan")


@pytest.fixture(params=INTERFACES)
def settings(request):
    channel = "vcan0" if request.param == "socketcan" else f"{request.node.name}-{os.getpid()}"
    return BusSettings(interface=request.param, channel=channel)
