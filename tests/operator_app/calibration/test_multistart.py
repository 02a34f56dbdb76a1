"""Starts of a fit of many poses: one that leads nowhere takes nothing away from what another found."""

from __future__ import annotations

import numpy as np
import pytest

from operator_app.calibration.multistart import FEW, fit_from_starts, gross_misfit
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.parameters import nominal_vector
from solver.diagnostics.limits import CHI2_PER_DOF_SECOND_START
from solver.errors import PosesDoNotFitError
from solver.estimators.error_model import ErrorModel
from tests.oracles.shop_floor import session

MODEL = load_fixture("hinge").fixture.model(load_arm("sarcos_dextrous"))
NOMINAL = nominal_vector(MODEL.parameters)
NOWHERE = np.full(len(NOMINAL), np.nan)


@pytest.fixture(scope="module")
def readings() -> np.ndarray:
    """More poses than tell which start is best, of an arm of which nothing but its encoders' noise is stated."""
    taken = session(1).readings
    times = 2 * FEW // len(taken) + 1
    noise = np.deg2rad(0.01) * np.random.default_rng(2).normal(size=(times, *taken.shape))
    return (taken + noise).reshape(-1, taken.shape[1])


@pytest.mark.parametrize(
    "starts", [(NOMINAL, NOWHERE), (NOWHERE, NOMINAL)], ids=["first", "second"]
)
def test_the_start_that_leads_somewhere_counts(readings, starts) -> None:
    """Where the second led nowhere the answer was that these poses do not fit this arm at all."""
    errors = ErrorModel(joint_variance=np.full(readings.shape, np.deg2rad(0.02) ** 2))
    group = np.ones(len(readings), dtype=np.int64)
    found = fit_from_starts(MODEL, readings, errors, starts, group=group)
    assert gross_misfit(found) > CHI2_PER_DOF_SECOND_START
    assert found.estimate.converged
    with pytest.raises(PosesDoNotFitError):
        fit_from_starts(MODEL, readings, errors, (NOWHERE, NOWHERE), group=group)
