"""Settings of every transport under contract. Imports no arm, as emulated machines are slow."""

import pytest

from hardware.buses.python_can import BusSettings
from tests.contracts.transports import TRANSPORTS


@pytest.fixture(params=TRANSPORTS)
def settings(request):
    return BusSettings(interface=request.param, channel=TRANSPORTS[request.param]())
