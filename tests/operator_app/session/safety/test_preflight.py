"""May what the joints read be true, where the arm stands? Asked of drawn arms, wherever they stand."""

import re
from dataclasses import replace

import numpy as np
import pytest

from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from operator_app.session.safety import preflight
from operator_app.session.safety.closure_gate import ClosureFit, loop_at_reading
from operator_app.session.safety.preflight import check_closure_without_poses
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import virtual_arm
from tests.oracles.wrong_zero import reading_of, with_shifted_zeros

FIXTURES = pytest.mark.parametrize("name", ["hinge", "ball", "rigid"])


@pytest.mark.sample(4)
@FIXTURES
@pytest.mark.parametrize("kind", ["exact", "datasheet", "as_reported", "wild"])
def test_a_sound_arm_is_accepted_in_any_position(name, kind):
    procedure = load_procedure(name)
    for seed in range(2):
        for q in sound_poses(procedure, kind, seed, 4):
            check_closure_without_poses(procedure, reading_of(procedure, q))


@pytest.mark.sample(10)
@FIXTURES
@pytest.mark.parametrize("kind", ["datasheet", "as_reported"])
@pytest.mark.parametrize("zeros", [(1,), (3,), (5,), (1, 4), (2, 3, 5)])
def test_a_sound_arm_with_joints_at_zero_is_accepted(name, kind, zeros):
    """Where a counter begins is a convention: these stand at zero in this very pose."""
    procedure = load_procedure(name)
    for q in sound_poses(procedure, kind, 1, 3):
        anew, there = _zeroed(procedure, q, zeros, q)
        check_closure_without_poses(anew, reading_of(anew, there))


class ClosesAsWell:
    """A loop that closes as well with the reading of joint 1, which is zero, as without; apart from rounding."""

    joints = (1,)
    reading_rad = np.zeros(7)

    def fit(self, *ignored_joints: int) -> ClosureFit:
        """Return the closure, a rounding error worse without readings."""
        more = len(ignored_joints)
        return ClosureFit(chi2=1.0 + 1e-12 * more, dof=5 - more, q_rad=np.zeros(7))


def test_a_counter_at_zero_without_effect_is_not_called_reset(monkeypatch):
    """The difference was a negative chi2, of which there is no probability."""
    monkeypatch.setattr(preflight, "loop_at_reading", lambda *_, **__: ClosesAsWell())
    procedure = load_procedure("hinge")
    assert check_closure_without_poses(procedure, reading_of(procedure, np.zeros(7))) > 0.9


@pytest.mark.sample(5)
@FIXTURES
@pytest.mark.parametrize("zeros", [(1,), (3,), (2, 4), (3, 5), (1, 2, 3)])
def test_counter_resets_are_named_in_any_position(name, zeros):
    """By 40 deg each; a ball, which leaves four freedoms, says so of most of them only."""
    procedure = load_procedure(name)
    said = []
    for q in sound_poses(procedure, "datasheet", 1, 4):
        before = q.copy()
        before[[j - 1 for j in zeros]] -= np.deg2rad(40.0)
        anew, there = _zeroed(procedure, q, zeros, before)
        said.append(_said(anew, there))
    found = [text for text in said if text]
    assert len(found) == 4 or (name == "ball" and len(found) >= 2)
    for text in found:
        named = re.search(r"counters? of joints? ([\d and]+) (is|are) at zero", text)
        assert {int(j) for j in re.findall(r"\d", named[1])} <= set(zeros)
        assert f"Home joint {named[1]}" in text


@pytest.mark.parametrize("degrees", [17.0, 22.0, 30.0])
def test_a_counter_reset_near_zero_is_named(degrees):
    """At 17 deg the loop closes with a chance of 1e-2, at 22 of 1e-4: little by itself, but not at zero."""
    procedure = load_procedure("hinge")
    q = procedure.arm.home_rad
    # The nearest closed pose has joint 1 elsewhere: a few times, and it has it there.
    for _ in range(20):
        there = q.copy()
        there[0] = np.deg2rad(degrees)
        (q,) = sound_poses(procedure, "datasheet", 1, 1, near=there)
    assert q[0] == pytest.approx(there[0], abs=np.deg2rad(0.1))
    read = q.copy()
    read[0] = 0.0
    with pytest.raises(GuardError, match="counter of joint 1 is at zero") as refused:
        check_closure_without_poses(procedure, reading_of(procedure, read))
    assert "really is at zero" in refused.value.remedy


def test_two_simultaneous_counter_resets_are_named():
    procedure = load_procedure("hinge")
    (q,) = sound_poses(procedure, "datasheet", 1, 1)
    before = q.copy()
    before[[1, 3]] -= np.deg2rad([40.0, -40.0])
    said = _said(*_zeroed(procedure, q, (2, 4), before))
    assert "counters of joints 2 and 4 are at zero" in said
    assert "Home joint 2 and 4" in said


def test_joints_with_home_near_zero_are_refused_with_evidence_only():
    """They stand there often; yet 30 deg are no doubt, though no 1e-12 either."""
    procedure = load_procedure("rigid")
    (q,) = sound_poses(procedure, "datasheet", 1, 1, near=procedure.arm.home_rad)
    for degrees, said in ((0.0, ""), (8.0, ""), (30.0, "counter of joint 2 is at zero")):
        before = q.copy()
        before[1] -= np.deg2rad(degrees)
        anew, there = _zeroed(procedure, q, (2,), before)
        home = anew.arm.home_rad.copy()
        home[1] = 0.0
        anew = replace(anew, arm=replace(anew.arm, home_rad=home))
        found = _said(anew, there)
        assert said in found
        assert bool(said) == bool(found)


def _said(procedure: Procedure, q_rad: np.ndarray) -> str:
    """Why these readings are refused; empty if they are not."""
    try:
        check_closure_without_poses(procedure, reading_of(procedure, q_rad))
    except GuardError as refused:
        return str(refused)
    return ""


def sound_poses(
    procedure: Procedure, kind: str, seed: int, count: int, *, near: np.ndarray | None = None
) -> list[np.ndarray]:
    """Readings (n,) of closed poses of a drawn arm; up to 20 deg from home, or the nearest to `near`."""
    arm, chosen = procedure.arm, Choices(scenario=kind, seed=seed)
    truth = virtual_arm(arm, procedure.fixture, chosen).true_loop()
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < count:
        away = np.deg2rad(rng.uniform(-20.0, 20.0, arm.joint_count))
        try:
            pose, _ = truth.closed_near(arm.home_rad + away if near is None else near)
        except ValueError:
            if near is not None:
                raise
            continue
        found.append(pose - truth.offsets_rad)
    return found


def _zeroed(
    procedure: Procedure, q_rad: np.ndarray, zeros: tuple[int, ...], truly_rad: np.ndarray
) -> tuple[Procedure, np.ndarray]:
    """The same arm where `zeros` count from `truly_rad` (n,), and what it reads at `q_rad` with all those at zero.

    With both the same they truly are there; else their counters began anew.
    """
    moved, columns = np.zeros(len(q_rad)), [j - 1 for j in zeros]
    moved[columns] = truly_rad[columns]
    read = q_rad - moved
    read[columns] = 0.0
    return with_shifted_zeros(procedure, moved), read


def test_a_loop_at_its_nominal_values_has_no_cost():
    procedure = load_procedure("hinge")
    found = loop_at_reading(procedure, procedure.arm.home_rad).fit()
    assert 0.0 <= found.chi2 < 1.0
    assert found.dof == 5
    np.testing.assert_allclose(found.q_rad, procedure.arm.home_rad, atol=np.deg2rad(3.0))
