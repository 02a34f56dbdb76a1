"""The faults of tests/oracles/shop_floor_faults: each is there, and nothing else is."""

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
def test_every_case_can_be_made(name):
    case = CASES[name](SEED)
    assert len(case.taken) == (3 if name == "3 poses" else 40)
    assert case.causes
    assert all(re.compile(c) for c in case.causes)
    assert np.isfinite(case.taken.readings).all()


def test_slipped_hinge_leaves_poses_before_it_alone():
    slipped, whole = CASES["hinge slips 5 mm"](SEED).taken, session(SEED)
    same = np.all(np.abs(slipped.angles - whole.angles) < 1e-9, axis=-1)
    at = int(np.argmin(same))
    assert 8 <= at < 33
    assert same[:at].all()
    assert not same[at:].any()
    moved = slipped.ground + slipped.hand - whole.ground - whole.hand
    assert np.linalg.norm(moved[at:, 3:], axis=-1) == pytest.approx(5e-3)


def test_slipped_joint_is_the_step_that_is_expected():
    case, whole = CASES["joint slips 1 deg"](SEED), session(SEED)
    off = np.rad2deg(case.taken.readings - whole.readings)
    (joint,) = set(np.nonzero(np.abs(off).max(axis=0))[0])
    assert case.causes == (f"STEP_JOINT_{joint + 1}",)
    assert sorted(set(np.round(np.abs(off[:, joint]), 9))) == [0.0, 1.0]
    (name, other), *_ = case.either.items()
    assert other - whole.truth[name] == pytest.approx(-np.deg2rad(off[-1, joint]))


@pytest.mark.campaign
def test_flipped_poses_close_upside_down():
    taken = CASES["12 flipped"](SEED).taken
    chain = taken.specimen.chain
    T = product(taken.angles, chain.s, chain.a, chain.alpha)
    over = T[:, 2, 2] < 0.0
    assert over.sum() == 12
    assert np.abs(T[over, :3, 3]).max() < 1e-10
    assert T[over, 2, 2] == pytest.approx(-1.0, abs=1e-10)


def test_ball_holds_the_place_and_not_the_turn():
    taken = CASES["ball for hinge"](SEED).taken
    chain = taken.specimen.chain
    T = product(taken.angles, chain.s, chain.a, chain.alpha)
    assert np.abs(T[:, :3, 3]).max() < 1e-10
    assert np.degrees(np.arccos(T[:, 2, 2])).max() > 5.0


def test_bent_rvdt_strays_by_what_it_says():
    case, whole = CASES["RVDT 5 %"](SEED), session(SEED)
    joint = int(case.causes[0][-1])
    rvdt = case.taken.specimen.sensors[joint - 1]
    angle = (whole.angles - whole.specimen.chain.theta_off)[:, joint]
    off = rvdt.deviation(angle)
    stray = off - np.polyval(np.polyfit(angle, off, 1), angle)
    assert np.abs(stray).max() == pytest.approx(0.05 * FULL_SCALE, rel=1e-6)


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", [1, 7])
def test_mount_is_that_near_to_parallel_and_closes(joint):
    chain, chart = parallel_mount(joint, 5.0)
    T = product(chart.angles, chain.s, chain.a, chain.alpha)
    assert np.abs(T - np.eye(4)).max() < 1e-10
    tilt = np.rad2deg(chain.alpha[0 if joint == 1 else 7]) % 180.0
    assert min(tilt, 180.0 - tilt) == pytest.approx(5.0, abs=1e-9)
