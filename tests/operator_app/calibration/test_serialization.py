"""A recorded calibration is read back bit by bit."""

import dataclasses
import json
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import RecordError, from_dict, to_dict
from operator_app.config.poses_file import load_poses
from solver.loops.closure import ClosureModel
from tests.contracts.planted import measured
from tests.oracles.as_shipped import ARM, BALL, HINGE
from tests.oracles.identity import same


def round_trip(value):
    return from_dict(type(value), json.loads(json.dumps(to_dict(value), allow_nan=False)))


@pytest.fixture(scope="module")
def hinge_poses(reference_data):
    poses = load_poses(reference_data / "hinge" / "hinge_quantised.csv").poses
    return poses.at_poses(np.arange(24))


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"estimator": "paper"},
        {"unsensed_joints": (6,), "length_tolerance_m": 1e-3},
        {"search": True},
    ],
)
def test_solution_is_read_back_exactly(hinge_poses, options):
    solution = calibrate(ARM, HINGE, hinge_poses, **options)
    again = round_trip(solution)
    assert isinstance(again, Solution)
    assert same(solution, again)
    assert not again.estimate.x.flags.writeable


def test_checks_are_read_back_exactly(hinge_poses):
    checks = check(calibrate(ARM, HINGE, hinge_poses), ARM, HINGE, hinge_poses)
    assert same(checks, round_trip(checks))
    assert same(Checks(), round_trip(Checks()))
    # Records of earlier versions have the whole test of each part.
    record = to_dict(checks)
    parts = record["held_out"]["parts"]
    record["held_out"]["parts"] = [{"verification": {"chi2": part}} for part in parts]
    assert same(checks, from_dict(Checks, record))


def test_closure_models_are_read_back_exactly(hinge_poses):
    three = dataclasses.replace(hinge_poses, placement=np.arange(24) % 3 + 1)
    endpoints = dataclasses.replace(hinge_poses, endpoint=np.tile(np.linspace(0, 1, 6), (24, 1)))
    for model in (
        Experiment(arm=ARM, fixture=BALL, poses=hinge_poses).loop(),
        Experiment(arm=ARM, fixture=BALL, poses=three, unsensed=(7,)).loop(),
        Experiment(arm=ARM, fixture=measured(ARM), poses=endpoints).loop(),
    ):
        assert same(OfLoop(model), round_trip(OfLoop(model)))


@dataclass(frozen=True)
class OfLoop:
    model: ClosureModel


@dataclass(frozen=True)
class Figure:
    value: float
    note: str = "none"


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_any_float_is_read_back(value):
    assert same(round_trip(Figure(value)), Figure(value))


def test_unknown_and_missing_default_fields_are_accepted():
    data = to_dict(Figure(1.5, "some"))
    assert from_dict(Figure, {**data, "later": 3}) == Figure(1.5, "some")
    del data["note"]
    assert from_dict(Figure, data) == Figure(1.5)


@pytest.mark.parametrize(
    "data", [{}, {"version": 0, "value": 1.0}, {"version": 1}, {"version": 1, "value": [1.0]}]
)
def test_invalid_record_is_refused(data):
    with pytest.raises(RecordError, match="not a Figure"):
        from_dict(Figure, data)
