"""A calibration with which nothing is wrong."""

import pytest

from operator_app.calibration.result import Solution
from tests.oracles.as_shipped import SEED, solved
from tests.oracles.shop_floor import session


@pytest.fixture(scope="session")
def sound() -> Solution:
    return solved(session(SEED))
