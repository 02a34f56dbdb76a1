"""The faults of tests/oracles/shop_floor_faults: each is present, and no other."""

import re

import numpy as np
import pytest

from tests.oracles.loop_oracle import product
from tests.oracles.shop_floor import FULL_SCALE, session
from tests.oracles.shop_floor_faults import CASES
from tests.oracles.shop_floor_parallel import parallel_mount

SEED = 5


@pytest.mark.campaign
@pytest.mark.parametrize("name", [n for n in CASES if not n.startswith("hinge ") or "slips" in n])
def test_every_case_can_be_simulated(name):
    case = CASES[name](SEED)
    assert len(case.taken) == (3 if name == "3 poses" else 40)
    assert case.causes
    assert all(re.compile(c) for c in case.causes)
    assert np.isfinite(case.taken.readings).all()


def test_hinge_step_changes_the_poses_after_it_only():
    stepped, sound = CASES["hinge slips 5 mm"](SEED).taken, session(SEED)
    same = np.all(np.abs(stepped.angles - sound.angles) < 1e-9, axis=-1)
    step = int(np.argmin(same))
    assert 8 <= step < 33
    assert same[:step].all()
    assert not same[step:].any()
    motion = stepped.ground + stepped.hand - sound.ground - sound.hand
    assert np.linalg.norm(motion[step:, 3:], axis=-1) == pytest.approx(5e-3)


def test_joint_step_has_the_expected_size_and_cause():
    case, sound = CASES["joint slips 1 deg"](SEED), session(SEED)
    change_deg = np.rad2deg(case.taken.readings - sound.readings)
    (joint,) = set(np.nonzero(np.abs(change_deg).max(axis=0))[0])
    assert case.causes == (f"STEP_JOINT_{joint + 1}",)
    assert sorted(set(np.round(np.abs(change_deg[:, joint]), 9))) == [0.0, 1.0]
    (name, alternative), *_ = case.either.items()
    assert alternative - sound.truth[name] == pytest.approx(-np.deg2rad(change_deg[-1, joint]))


@pytest.mark.campaign
def test_flipped_poses_close_with_flipped_tool():
    simulated = CASES["12 flipped"](SEED).taken
    chain = simulated.specimen.chain
    T = product(simulated.angles, chain.s, chain.a, chain.alpha)
    flipped = T[:, 2, 2] < 0.0
    assert flipped.sum() == 12
    assert np.abs(T[flipped, :3, 3]).max() < 1e-10
    assert T[flipped, 2, 2] == pytest.approx(-1.0, abs=1e-10)


def test_ball_constrains_position_and_not_orientation():
    simulated = CASES["ball for hinge"](SEED).taken
    chain = simulated.specimen.chain
    T = product(simulated.angles, chain.s, chain.a, chain.alpha)
    assert np.abs(T[:, :3, 3]).max() < 1e-10
    assert np.degrees(np.arccos(T[:, 2, 2])).max() > 5.0


def test_nonlinear_rvdt_deviates_by_the_stated_amount():
    case, sound = CASES["RVDT 5 %"](SEED), session(SEED)
    joint = int(case.causes[0][-1])
    rvdt = case.taken.specimen.sensors[joint - 1]
    angle = (sound.angles - sound.specimen.chain.theta_off)[:, joint]
    error = rvdt.deviation(angle)
    nonlinearity = error - np.polyval(np.polyfit(angle, error, 1), angle)
    assert np.abs(nonlinearity).max() == pytest.approx(0.05 * FULL_SCALE, rel=1e-6)


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", [1, 7])
def test_parallel_mount_has_the_stated_angle_and_closes(joint):
    chain, chart = parallel_mount(joint, 5.0)
    T = product(chart.angles, chain.s, chain.a, chain.alpha)
    assert np.abs(T - np.eye(4)).max() < 1e-10
    tilt = np.rad2deg(chain.alpha[0 if joint == 1 else 7]) % 180.0
    assert min(tilt, 180.0 - tilt) == pytest.approx(5.0, abs=1e-9)
