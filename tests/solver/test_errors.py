"""Errors of the solver and of files keep class, message and attributes when pickled."""

import pickle

import pytest

from operator_app.config.errors import ConfigError, Problem
from solver.errors import (
    PosesDoNotFitError,
    TooFewPosesError,
    UnidentifiableDirection,
    UnidentifiableError,
)

ERRORS = [
    ConfigError(
        [Problem(file="arm.yaml", key="dh[2]", text="is no number", remedy="write one", line=7)]
    ),
    PosesDoNotFitError(("a ball: calibrate with --fixture ball",), codes=("WRONG_FIXTURE",)),
    TooFewPosesError(poses=2, needed=3, parameters=14, equations_per_pose=5),
    UnidentifiableError((UnidentifiableDirection(parameters=("s_0", "s_1"), weights=(1.0, 1.0)),)),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
def test_pickled_error_is_equal(error):
    unpickled = pickle.loads(pickle.dumps(error))  # noqa: S301 - pickled by this test
    assert type(unpickled) is type(error)
    assert str(unpickled) == str(error)
    assert unpickled.__dict__ == error.__dict__
