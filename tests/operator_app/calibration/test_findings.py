"""Faults planted in readings are the first finding, with name and size."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.findings import left_out_poses, rms_displacement
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.messages.finding import FindingKind
from solver.diagnostics.range_checks import range_findings
from tests.benchmarks.shop_floor_outcome import ACCEPTED, WARNED, outcome
from tests.oracles.as_shipped import ARM, displaced, poses_of, spread_out
from tests.oracles.open_arm import write_measured_poses
from tests.oracles.shop_floor import session


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ("instrument", FindingKind.INSTRUMENT_MOVED),
        ("scatter", FindingKind.INSTRUMENT_DEFLECTS_MORE),
        ("joint 7", FindingKind.READING_OR_TARGET_STEP),
        ("joint 4", FindingKind.READING_STEP),
    ],
)
def test_finding_about_an_instrument_names_no_fixture(tmp_path, change, kind):
    path = write_measured_poses(tmp_path / "open.csv")
    poses, tracker = load_poses(str(path), joint_count=7).poses, load_fixture("tracker").fixture
    late, endpoint = np.arange(len(poses)) >= 20, np.array(poses.endpoint)
    if change == "instrument":
        poses = replace(poses, endpoint=endpoint + np.outer(late, [0.0, 0.003, 0.001]))
    elif change == "scatter":
        noise = np.random.default_rng(4).normal(size=endpoint.shape)
        poses = replace(poses, endpoint=endpoint + 2e-3 * noise)
    else:
        poses = displaced(poses, (late, int(change[-1]) - 1), 1.5)
    first = calibrate(ARM, tracker, poses, drop=True).causes[0]
    assert first.kind is kind
    assert first.code == kind.code.format(joint=first.joint)


def test_slip_is_as_large_as_in_the_placement_in_which_it_happened():
    """The later placement has coefficients of its own, close to zero."""
    moved = np.repeat([[0.0, 0.0, 0.0], [0.0, 0.003, 0.0], [1e-6, 0.0, 0.0]], 20, axis=0)
    placement, order = np.repeat([1, 2], [40, 20]), np.random.default_rng(0).permutation(60)
    group = np.empty_like(placement)
    group[order] = placement
    faults = SimpleNamespace(
        system=SimpleNamespace(w=moved, E=np.tile(np.eye(3), (60, 1, 1))),
        design=SimpleNamespace(group=group),
        order=order,
    )
    slip = SimpleNamespace(candidate=SimpleNamespace(moves=lambda *_: moved), b=None)
    assert rms_displacement(slip, faults) == {"turn_rad": 0.0, "shift_m": pytest.approx(0.003)}


SCALE, SCATTER = r"encoder is off by about (\S+) %", r"scatter by about ([0-9.]+) deg"


def of_joints(q, *joints):
    """1 in the columns of these joints, 0 in the others."""
    return np.isin(np.arange(1, 8), joints) * np.ones_like(q)


def in_radians(q, *joints):
    return np.where(of_joints(q, *joints), np.deg2rad(q), q)


def drifting(q, joint, degrees):
    return q + np.deg2rad(degrees) * np.linspace(0.0, 1.0, len(q))[:, None] * of_joints(q, joint)


def scattered(q, degrees):
    return q + np.deg2rad(degrees) * np.random.default_rng(61).normal(size=q.shape)


# Seed, fault with its arguments, first cause, its size and the pattern of its text.
FAULTS = [
    (21, lambda q: np.mod(q + np.pi, 2.0 * np.pi) - np.pi, (), "WHOLE_TURNS_2_5_6", 0.0, ""),
    *(
        (21, in_radians, joints, "_".join(map(str, ("RADIANS", *joints))), 0.0, "")
        for joints in ((4,), (7,), (6, 7), (1, 2, 3))
    ),
    *(
        (61, lambda q, j, k: q * (1.0 + 0.01 * k * of_joints(q, j)), (j, k), f"SCALE_{j}", k, SCALE)
        for j, k in ((2, 5.0), (5, -5.0), (3, 1.0), (4, 1.0), (5, 1.0))
    ),
    *((61, scattered, (size,), "SCATTER", size, SCATTER) for size in (0.1, 0.2, 0.3)),
    *(
        (seed, drifting, (joint, size), f"DRIFT_JOINT_{joint}", 0.0, "")
        for seed, joint, size in ((62, 7, 0.1), (63, 1, 0.3), (64, 2, 0.1))
    ),
]


@pytest.mark.sample(7)
@pytest.mark.parametrize(
    ("seed", "change", "arguments", "code", "size", "pattern"), FAULTS, ids=[f[3] for f in FAULTS]
)
def test_reading_fault_is_the_first_cause(seed, change, arguments, code, size, pattern):
    taken = session(seed)
    result = outcome(replace(taken, readings=change(taken.readings, *arguments)))
    assert result.verdict != ACCEPTED
    codes = [c for c in result.causes if not c.startswith("RANGE")]
    assert codes[0] == code, result.text
    assert "WRONG_FIXTURE" not in codes
    if pattern:
        tolerance = 0.1 if pattern is SCATTER else 0.25
        assert float(re.search(pattern, result.text)[1]) == pytest.approx(size, rel=tolerance)


@pytest.mark.parametrize(
    ("rows", "code"), [(slice(7, 8), "RANGE_RADIANS"), (slice(20, 40), "RADIANS_POSES")]
)
def test_rows_in_radians_are_not_reported_as_flipped(rows, code):
    taken = session(21)
    readings = taken.readings.copy()
    readings[rows] = np.deg2rad(readings[rows])
    result = outcome(replace(taken, readings=readings))
    assert result.causes == (code,), result.text
    assert not {"FLIPPED_BRANCH", "RANGE"} & set(result.warnings)


@pytest.mark.parametrize("poses", [slice(None), slice(4, 6)])
def test_motion_during_sampling_is_named(poses):
    result = outcome(spread_out(session(61), (poses, 2), 1.0))
    assert result.verdict == WARNED
    assert result.causes == ("UNSTEADY_3",)
    assert "UNSTEADY_3" in result.warnings
    assert "spread by up to 1.000 deg within pose" in result.text


def test_left_out_poses_have_their_reason():
    poses = poses_of(session(21))
    beyond = displaced(poses, (3, slice(1, 4)), np.rad2deg(-3.0))
    (range_pose, flipped), _ = left_out_poses((3, 5), range_findings(ARM, beyond), ARM, beyond)
    assert (range_pose.code, flipped.code) == ("RANGE_POSE", "FLIPPED_BRANCH")
    assert range_pose.joints == (2, 3, 4)
    assert flipped.poses == (poses.label[5],)
    (both,), _ = left_out_poses((4, 5), (), ARM, poses)
    assert both.poses == (poses.label[4], poses.label[5])
