"""Starts of a fit: the one that converges is used; diverged solutions and displaced fixtures."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.acceptance import Verdict, little_motion
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.multistart import (
    SCREENING_POSES,
    fit_from_starts,
    gross_misfit,
    local_minimum_causes,
)
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from solver.chain.parameters import nominal_vector
from solver.diagnostics.limits import CHI2_PER_DOF_SECOND_START
from solver.errors import PosesDoNotFitError
from solver.estimators.error_model import ErrorModel
from tests.oracles.as_shipped import ARM, BALL, HINGE, PANDA, fit_of, panda_poses, poses_of, solved
from tests.oracles.shop_floor import session
from tests.oracles.shop_floor_faults import CASES
from tests.oracles.shop_floor_misread import hysteresis

MODEL = HINGE.model(ARM)
NOMINAL = nominal_vector(MODEL.parameters)
DIVERGING = np.full(len(NOMINAL), np.nan)


@pytest.fixture(scope="module")
def readings():
    """More poses than the screening of starts takes, of an arm with encoder noise only."""
    taken = session(1).readings
    times = 2 * SCREENING_POSES // len(taken) + 1
    noise = np.deg2rad(0.01) * np.random.default_rng(2).normal(size=(times, *taken.shape))
    return (taken + noise).reshape(-1, taken.shape[1])


@pytest.mark.parametrize("starts", [(NOMINAL, DIVERGING), (DIVERGING, NOMINAL)])
def test_start_that_converges_is_used(readings, starts):
    errors = ErrorModel(joint_variance=np.full(readings.shape, np.deg2rad(0.02) ** 2))
    group = np.ones(len(readings), dtype=np.int64)
    fit = fit_from_starts(MODEL, readings, errors, starts, group=group)
    assert gross_misfit(fit) > CHI2_PER_DOF_SECOND_START
    assert fit.estimate.converged
    with pytest.raises(PosesDoNotFitError):
        fit_from_starts(MODEL, readings, errors, (DIVERGING, DIVERGING), group=group)


def test_diverged_solution_gives_no_advice_and_a_sound_one_does():
    solution = solved(hysteresis(session(7), 6, 4.0))
    assert solution.adjudication.diverged
    assert solution.causes[0].code == "RVDT_6"
    assert solution.causes[0].blocking
    facts = facts_of(solution)
    text = " ".join(facts_text(facts).split())
    for advice in (
        "Use implicit",
        "remount the hinge",
        "poses that differ more",
        "To halve a source",
    ):
        assert advice not in text
    assert "neither estimate is usable" in text
    assert facts.json["halved"] == {}
    sound = solved(session(7))
    assert not sound.adjudication.diverged
    assert "Use implicit" in facts_text(facts_of(sound))


def test_slip_of_the_tool_half_is_named_also_in_a_displaced_hinge():
    """It is neither a length error, nor outliers, nor divergence."""
    taken = CASES["hinge slips 5 mm"](3002).taken
    displaced = replace(HINGE, s_1_m=HINGE.s_1_m + 0.12)
    solution, nominal = calibrate(ARM, displaced, poses_of(taken)), solved(taken)
    for result in (nominal, solution):
        assert [c.code for c in result.causes] == ["SLIP_FIXTURE"]
    assert nominal.causes[0].names == ("tool",)
    assert nominal.causes[0].figures["shift_m"] == pytest.approx(5e-3, abs=5e-5)
    assert not solution.adjudication.diverged
    assert "FIXTURE_ELSEWHERE" in [n.code for n in solution.warnings]
    apart = np.abs(solution.estimate.x - nominal.estimate.x) / nominal.estimate.standard_deviation
    assert apart.max() < 1.0


def test_value_far_from_the_files_is_refused_where_a_joint_is_unsensed():
    solution = calibrate(PANDA, BALL, panda_poses(1, 2), unsensed_joints=(6,), drop=True)
    names = [p.name for p in solution.estimate.parameters]
    assert solution.accepted
    assert local_minimum_causes(solution.model, solution.estimate) == ()
    mirrored = solution.estimate.x - 0.4 * np.eye(len(names))[names.index("tip_z")]
    estimate = replace(solution.estimate, x=mirrored)
    (far,) = local_minimum_causes(solution.model, estimate)
    assert (far.code, far.names, far.blocking) == ("FAR_FROM_NOMINAL", ("tip_z",), True)


def test_little_motion_is_reported_once():
    solution = solved(CASES["motion 5 deg"](3).taken)
    assert Counter(cause.code for cause in solution.causes)["LITTLE_MOTION"] == 1


@pytest.mark.parametrize(
    ("name", "taken", "remedy"),
    [
        ("theta_off_4", session(2), "take more poses"),
        (
            "theta_off_7",
            CASES["RVDT 5 %"](3).taken,
            "to halve the largest contribution to them, replace the RVDT of joint 7",
        ),
    ],
    ids=["as stated", "a bent RVDT"],
)
def test_remedy_of_a_wide_sigma_is_its_source_or_more_poses(name, taken, remedy):
    fit = fit_of(taken)
    others = {p.name for p in fit.estimate.parameters} - {name}
    (cause,) = little_motion(fit.estimate.without(others), {name: 1e-9}, fit)
    assert cause.code == "LITTLE_MOTION"
    assert cause.remedy.startswith(remedy)


@pytest.mark.parametrize("sockets", [(1,), (1, 2)])
def test_displaced_socket_is_a_note(sockets):
    """Real poses of a Panda; the packaged ball's socket is a metre away."""
    displaced = replace(BALL, ground_m=(0.9, 0.0, 0.1))
    solution = calibrate(PANDA, displaced, panda_poses(*sockets))
    (note,) = (n for n in solution.warnings if n.code == "SOCKET_ELSEWHERE")
    assert note.names[0].startswith("ground_x")
    assert note.size == pytest.approx(-1.36, abs=0.02)
    assert solution.verdict is Verdict.ACCEPTED


def test_displaced_tool_point_is_refused():
    x, y, z = BALL.tip_m
    solution = calibrate(PANDA, replace(BALL, tip_m=(x + 0.12, y, z)), panda_poses(1, 2))
    assert solution.verdict is Verdict.NOT_ACCEPTED
    assert solution.causes[0].code == "FAR_FROM_NOMINAL"
    assert solution.causes[0].names == ("tip_x",)


@pytest.mark.parametrize(("name", "shift_m"), [("s_1", 0.12), ("a_7", -0.1)])
def test_displaced_hinge_is_a_note(name, shift_m):
    """Where axes are nearly parallel, a tilt of a few degrees moves the common normal this far."""
    field = f"{name.replace('7', 'n')}_m"
    displaced = replace(HINGE, **{field: getattr(HINGE, field) + shift_m})
    poses = poses_of(session(0))
    solution = calibrate(ARM, displaced, poses)
    (note,) = (n for n in solution.warnings if n.code == "FIXTURE_ELSEWHERE")
    assert note.names == (name,)
    assert note.size == pytest.approx(-shift_m, abs=0.02)
    assert solution.verdict is Verdict.ACCEPTED
    nominal = solved(session(0)).estimate
    apart = np.abs(solution.estimate.x - nominal.x) / nominal.standard_deviation
    assert apart.max() < 1.0
