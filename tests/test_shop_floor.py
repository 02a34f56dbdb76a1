"""The generator of tests/oracles/shop_floor*: a loop that closes, and errors of the sizes it states."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.oracles.loop_oracle import product
from tests.oracles.pinocchio_chain import PinocchioChain
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
from tests.oracles.shop_floor_chain import frames, misclosure, screws
from tests.oracles.shop_floor_load import hinge_wrench
from tests.oracles.shop_floor_walk import LOWER_DEG, UPPER_DEG, nominal_chain, nominal_chart

ARMS = range(100, 140)
LSB = FULL_SCALE / 4096


@pytest.fixture(scope="module")
def specimens():
    return [Specimen.drawn(seed, Sizes()) for seed in ARMS]


@pytest.fixture(scope="module")
def sessions():
    return [session(seed) for seed in ARMS]


def test_chain_is_pinocchios():
    rng = np.random.default_rng(1)
    chain = session(1, Sizes(), poses=2).specimen.chain
    angles = rng.uniform(-3.0, 3.0, (20, 8))
    ours, theirs = frames(chain, angles), PinocchioChain(8)
    for k in range(20):
        turns, origins = theirs.frames(angles[k], chain.s, chain.a, chain.alpha)
        assert ours[k, :9, :3, :3] == pytest.approx(turns, abs=1e-13)
        assert ours[k, :9, :3, 3] == pytest.approx(origins, abs=1e-13)
        jacobian = theirs.jacobian(angles[k], chain.s, chain.a, chain.alpha)[:, 0]
        assert screws(ours)[k] == pytest.approx(jacobian, abs=1e-12)


@pytest.mark.parametrize("sources", [(), tuple(SOURCES)])
def test_loops_close_with_every_error_in(sources):
    taken = session(7, Sizes.only(*sources))
    chain = taken.specimen.chain
    give = [_homogeneous(taken.ground), _homogeneous(taken.hand)]
    zero = np.zeros(8)
    first = product(taken.angles[:, :1], zero[:1], zero[:1], zero[:1])
    link_0 = product(zero[:1], chain.s[:1], chain.a[:1], chain.alpha[:1])
    rest = product(taken.angles[:, 1:], chain.s[1:], chain.a[1:], chain.alpha[1:])
    whole = first @ give[0] @ link_0 @ rest @ give[1]
    assert whole == pytest.approx(np.broadcast_to(np.eye(4), whole.shape), abs=1e-10)
    assert (np.abs(taken.ground).max() > 1e-5) == ("give" in sources)
    # What cannot be seen in the readings: they are off by their errors, and by nothing else.
    off = taken.readings - (taken.angles - chain.theta_off)[:, 1:]
    assert np.abs(off[:, :5]).max() < (1e-3 if sources else 1e-5)
    gain = 0.5 * FULL_SCALE * max(abs(s.gain) for s in taken.specimen.sensors[5:])
    assert np.abs(off[:, 5:]).max() < 0.02 * FULL_SCALE + gain + (3.0 * LSB + 1e-3)


def test_gravity_torque_is_the_slope_of_potential_energy():
    taken = session(3, poses=4)
    load, chain = taken.specimen.load, taken.specimen.chain

    def energy(angles):
        T = frames(chain, angles)
        base = np.linalg.inv(T[:, 1])
        height = 0.0
        for link in range(1, 8):
            centre = np.append(load.masses.centre[link], 1.0)
            at = (base @ T[:, link + 1] @ centre)[:, :3]
            height = height - load.masses.mass[link] * 9.81 * (at @ load.down)
        return height

    torque = load.torque(frames(chain, taken.angles))
    for joint in range(1, 8):
        step = 1e-5 * np.eye(8)[joint]
        slope = (energy(taken.angles + step) - energy(taken.angles - step)) / 2e-5
        assert torque[:, joint] == pytest.approx(-slope, abs=1e-6)


def test_hinge_carries_what_the_free_joints_do_not():
    """A hand let go a little does the work that the wrench says: virtual work, by differences."""
    taken = session(3, poses=6)
    load, chain = taken.specimen.load, taken.specimen.chain
    T = frames(chain, taken.angles)
    carried = load.torque(T) - load.believed.torque(T, load.down)
    on_hand = hinge_wrench(T, carried, rub=0.0)
    for joint in (2, 3, 4, 6, 7):
        step = 1e-6 * np.eye(8)[joint]
        moved = misclosure(frames(chain, taken.angles + step))
        moved = (moved - misclosure(frames(chain, taken.angles - step))) / 2e-6
        assert (moved * on_hand).sum(axis=-1) == pytest.approx(-carried[:, joint], abs=1e-4)
    assert on_hand[:, 2] == pytest.approx(0.0, abs=1e-12)
    rubbed = load.wrenches(T, taken.angles)[1]
    assert np.linalg.norm(rubbed, axis=-1).max() < np.linalg.norm(on_hand, axis=-1).max()


def test_lengths_and_twists_have_the_stated_size(specimens):
    base = nominal_chain()
    for names, size in ((LENGTHS, 0.5e-3), (TWISTS, np.deg2rad(0.1))):
        off = [s.chain.value(n) - base.value(n) for s in specimens for n in names]
        assert np.std(off) == pytest.approx(size, rel=0.15)
        assert abs(np.mean(off)) < 0.2 * size


def test_encoders_have_the_stated_size(specimens):
    angles = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    off = [s.sensors[j - 1].deviation(angles) for s in specimens for j in ENCODERS]
    # Two harmonics, of 0.01 deg each.
    assert np.rad2deg(np.std(off)) == pytest.approx(0.01 * np.sqrt(2.0), rel=0.15)


def test_rvdts_bend_within_two_percent_use_half_of_it_and_have_the_stated_gain(specimens):
    slopes = []
    for joint in RVDTS:
        middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)[joint - 1])
        angles = middle + np.linspace(-0.5, 0.5, 501) * FULL_SCALE
        off = np.array([s.sensors[joint - 1].deviation(angles) for s in specimens])
        slope, constant = np.polyfit(angles - middle, off.T, 1)
        curve = off - np.multiply.outer(slope, angles - middle) - constant[:, None]
        worst = np.abs(curve).max(axis=1) / FULL_SCALE
        assert worst.max() <= 0.02 + 1e-4
        assert worst.min() >= 0.01 - 1e-4
        assert np.abs(constant).max() < 1e-4 * FULL_SCALE
        slopes.append(slope)
    assert np.std(slopes) == pytest.approx(0.005, rel=0.2)


@pytest.mark.campaign
def test_hinge_and_joints_give_by_the_stated_sizes(sessions):
    for rows, size in ((slice(0, 3), 0.2e-3), (slice(3, 6), 0.2e-3)):
        square = [np.mean(s.ground[:, rows] ** 2) + np.mean(s.hand[:, rows] ** 2) for s in sessions]
        assert np.sqrt(np.mean(square)) == pytest.approx(size, rel=0.25)
    sag = []
    for s in sessions:
        torque = s.specimen.load.torque(frames(s.specimen.chain, s.angles))
        sag.append((s.specimen.load.sag * torque)[:, 1:])
    assert np.rad2deg(np.sqrt(np.mean(np.square(sag)))) == pytest.approx(0.01, rel=0.2)


def test_what_gives_is_smooth_with_load():
    """Poses five degrees apart give alike."""
    chain, angles = nominal_chain(), nominal_chart().angles
    place = nominal_chart().place
    for seed in range(5):
        load = Specimen.drawn(seed, Sizes()).load
        give = np.concatenate(load.give(frames(chain, angles), angles), axis=-1)
        near = np.linalg.norm(place[:, None] - place, axis=-1)
        first, second = np.nonzero((near > 0.0) & (near < np.deg2rad(6.0)))
        assert np.sqrt(np.mean((give[first] - give[second]) ** 2)) < 0.3 * np.sqrt(np.mean(give**2))


def test_noise_of_single_readings():
    for lsb in (1.0, 8.0):
        spreads = [session(k, Sizes.only(), poses=30).spread for k in range(2)]
        assert np.abs(np.concatenate(spreads)[:, :5]).max() == 0.0
        noisy = session(5, Sizes(noise_lsb=lsb), poses=40).spread[:, 5:]
        found = np.sqrt(np.mean(noisy**2)) / LSB
        assert found == pytest.approx(np.sqrt(lsb**2 + 1.0 / 12.0), rel=0.08)


def test_a_source_of_its_own_leaves_the_others_alone():
    every, twists = session(11), session(11, Sizes.only("twists"))
    for name in (*PARAMETERS, *TWISTS):
        assert every.truth[name] == twists.truth[name]
    assert every.truth["s_3"] != twists.truth["s_3"] == 0.355
    assert np.array_equal(every.specimen.sensors[5].shape, twists.specimen.sensors[5].shape)
    doubled = Sizes.everything(times=2.0)
    assert session(11, doubled).truth["alpha_3"] - nominal_chain().value("alpha_3") == (
        pytest.approx(2.0 * (every.truth["alpha_3"] - nominal_chain().value("alpha_3")))
    )


def test_sessions_stay_in_range_and_repeat(sessions):
    for taken in sessions[:10]:
        deg = np.rad2deg(taken.readings)
        assert np.all((deg > LOWER_DEG) & (deg < UPPER_DEG))
        assert np.all(np.ptp(deg, axis=0) > 8.0)
    again = session(ARMS[0])
    assert np.array_equal(again.readings, sessions[0].readings)
    assert not np.array_equal(session(ARMS[0], walk=1).readings, again.readings)


def _homogeneous(small):
    out = np.tile(np.eye(4), (len(small), 1, 1))
    out[:, :3, :3] = Rotation.from_rotvec(small[:, :3]).as_matrix()
    out[:, :3, 3] = small[:, 3:]
    return out
