"""A calibration with which nothing is wrong."""

import pytest

from tests.oracles.as_shipped import SEED, solved
from tests.oracles.shop_floor import session


@pytest.fixture(scope="session")
def sound():
    return solved(session(SEED))
