"""The simulator of tests/oracles/shop_floor*: its loops close, its errors and faults have the stated sizes."""

import numpy as np
import pytest

from tests.oracles.loop_oracle import product
from tests.oracles.pinocchio_chain import PinocchioGravity
from tests.oracles.shop_floor import (
    ENCODERS,
    FULL_SCALE,
    LENGTHS,
    PARAMETERS,
    RVDTS,
    SOURCES,
    TWISTS,
    Sizes,
    Specimen,
    session,
)
from tests.oracles.shop_floor_chain import (
    LOWER_DEG,
    UPPER_DEG,
    displacement,
    frames,
    misclosure,
    nominal_chain,
)
from tests.oracles.shop_floor_faults import CASES
from tests.oracles.shop_floor_load import hinge_wrench

ARMS = range(100, 140)
SEED = 5
LSB = FULL_SCALE / 4096


@pytest.fixture(scope="module")
def specimens():
    return [Specimen.drawn(seed, Sizes()) for seed in ARMS]


@pytest.mark.parametrize("sources", [(), tuple(SOURCES)])
def test_loops_close_with_and_without_errors(sources):
    simulated = session(7, Sizes.only(*sources))
    chain = simulated.specimen.chain
    deflection = [displacement(d) for d in (simulated.ground, simulated.hand)]
    zero = np.zeros(8)
    first = product(simulated.angles[:, :1], zero[:1], zero[:1], zero[:1])
    link_0 = product(zero[:1], chain.s[:1], chain.a[:1], chain.alpha[:1])
    rest = product(simulated.angles[:, 1:], chain.s[1:], chain.a[1:], chain.alpha[1:])
    loop = first @ deflection[0] @ link_0 @ rest @ deflection[1]
    assert loop == pytest.approx(np.broadcast_to(np.eye(4), loop.shape), abs=1e-10)
    assert (np.abs(simulated.ground).max() > 1e-5) == ("give" in sources)
    # Readings differ from the true angles by sensor errors only.
    error = simulated.readings - (simulated.angles - chain.theta_off)[:, 1:]
    assert np.abs(error[:, :5]).max() < (1e-3 if sources else 1e-5)
    gain = 0.5 * FULL_SCALE * max(abs(s.gain) for s in simulated.specimen.sensors[5:])
    assert np.abs(error[:, 5:]).max() < 0.02 * FULL_SCALE + gain + (3.0 * LSB + 1e-3)


def test_gravity_torque_agrees_with_pinocchio():
    simulated = session(3, poses=4)
    load, chain = simulated.specimen.load, simulated.specimen.chain
    T, table = frames(chain, simulated.angles), (chain.s, chain.a, chain.alpha)
    # Pinocchio has a link's mass in the frame after the rotation of its joint.
    links = product(np.zeros((8, 1)), *(column[:, None] for column in table))
    centre = (links @ np.column_stack((load.masses.centre, np.ones(8)))[..., None])[:, :3, 0]
    for k, angles in enumerate(simulated.angles):
        down = T[k, 1, :3, :3] @ load.down
        oracle = PinocchioGravity(load.masses.mass, centre, 9.81 * down)
        expected = -oracle.holding_torque(angles, *table)
        assert load.torque(T)[k, 1:] == pytest.approx(expected[1:], abs=1e-9)


def test_hinge_wrench_does_the_virtual_work_of_the_free_joints():
    simulated = session(3, poses=6)
    load, chain = simulated.specimen.load, simulated.specimen.chain
    T = frames(chain, simulated.angles)
    free_torque = load.torque(T) - load.stated_masses.torque(T, load.down)
    wrench = hinge_wrench(T, free_torque, rub=0.0)
    for joint in (2, 3, 4, 6, 7):
        step = 1e-6 * np.eye(8)[joint]
        motion = misclosure(frames(chain, simulated.angles + step))
        motion = (motion - misclosure(frames(chain, simulated.angles - step))) / 2e-6
        assert (motion * wrench).sum(axis=-1) == pytest.approx(-free_torque[:, joint], abs=1e-4)
    assert wrench[:, 2] == pytest.approx(0.0, abs=1e-12)
    with_friction = load.wrenches(T, simulated.angles)[1]
    assert np.linalg.norm(with_friction, axis=-1).max() < np.linalg.norm(wrench, axis=-1).max()


def test_lengths_twists_and_encoders_have_the_stated_sigma(specimens):
    base, angles = nominal_chain(), np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    for names, size in ((LENGTHS, 0.5e-3), (TWISTS, np.deg2rad(0.1))):
        errors = [s.chain.value(n) - base.value(n) for s in specimens for n in names]
        assert np.std(errors) == pytest.approx(size, rel=0.15)
        assert abs(np.mean(errors)) < 0.2 * size
    errors = [s.sensors[j - 1].deviation(angles) for s in specimens for j in ENCODERS]
    # Two harmonics, of 0.01 deg each.
    assert np.rad2deg(np.std(errors)) == pytest.approx(0.01 * np.sqrt(2.0), rel=0.15)


def test_rvdt_linearity_and_gain_have_the_stated_sizes(specimens):
    slopes = []
    for joint in RVDTS:
        middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)[joint - 1])
        angles = middle + np.linspace(-0.5, 0.5, 501) * FULL_SCALE
        errors = np.array([s.sensors[joint - 1].deviation(angles) for s in specimens])
        slope, constant = np.polyfit(angles - middle, errors.T, 1)
        curve = errors - np.multiply.outer(slope, angles - middle) - constant[:, None]
        worst = np.abs(curve).max(axis=1) / FULL_SCALE
        assert worst.max() <= 0.02 + 1e-4
        assert worst.min() >= 0.01 - 1e-4
        assert np.abs(constant).max() < 1e-4 * FULL_SCALE
        slopes.append(slope)
    assert np.std(slopes) == pytest.approx(0.005, rel=0.2)


@pytest.mark.campaign
def test_hinge_and_joint_deflections_have_the_stated_sizes():
    sessions = [session(seed) for seed in ARMS]
    for rows, size in ((slice(0, 3), 0.2e-3), (slice(3, 6), 0.2e-3)):
        squares = [
            np.mean(s.ground[:, rows] ** 2) + np.mean(s.hand[:, rows] ** 2) for s in sessions
        ]
        assert np.sqrt(np.mean(squares)) == pytest.approx(size, rel=0.25)
    sag = []
    for s in sessions:
        torque = s.specimen.load.torque(frames(s.specimen.chain, s.angles))
        sag.append((s.specimen.load.sag * torque)[:, 1:])
    assert np.rad2deg(np.sqrt(np.mean(np.square(sag)))) == pytest.approx(0.01, rel=0.2)


def test_each_error_source_has_a_random_stream_of_its_own():
    full, twists = session(11), session(11, Sizes.only("twists"))
    for name in (*PARAMETERS, *TWISTS):
        assert full.truth[name] == twists.truth[name]
    assert full.truth["s_3"] != twists.truth["s_3"] == 0.355
    assert np.array_equal(full.specimen.sensors[5].shape, twists.specimen.sensors[5].shape)
    doubled, nominal = (
        session(11, Sizes.only(*SOURCES, times=2.0)),
        nominal_chain().value("alpha_3"),
    )
    error = full.truth["alpha_3"] - nominal
    assert doubled.truth["alpha_3"] - nominal == pytest.approx(2.0 * error)


def test_nonlinear_rvdt_deviates_by_the_stated_amount():
    case, sound = CASES["RVDT 5 %"](SEED), session(SEED)
    joint = int(case.causes[0][-1])
    angle = (sound.angles - sound.specimen.chain.theta_off)[:, joint]
    error = case.taken.specimen.sensors[joint - 1].deviation(angle)
    nonlinearity = error - np.polyval(np.polyfit(angle, error, 1), angle)
    assert np.abs(nonlinearity).max() == pytest.approx(0.05 * FULL_SCALE, rel=1e-6)
