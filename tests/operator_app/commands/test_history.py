"""`sarcal history`: sessions one month apart, of an arm whose joint 4 shifts before the sixth."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from operator_app.calibration.history import PastVerification, history_of
from operator_app.config.parameters_file import ParametersDocument
from operator_app.config.poses_file import load_poses
from operator_app.config.resources import resolve
from operator_app.documents import arm_history
from operator_app.report.results.history import history_text
from operator_app.session.store.stored_calibration import solve
from operator_app.session.workflow.importing import UNKNOWN_SERIAL_NUMBER, ImportedSession
from solver.chain.poses import PoseSet

HINGE = Path(__file__).parents[2] / "data/hinge/hinge_exact.csv"
SERIAL = "SDA-7"
NOISE_DEG = np.array([0.004, 0.004, 0.004, 0.004, 0.004, 0.05, 0.05])
SHIFT_DEG, SHIFTED_SESSION, SESSIONS = 0.3, 5, 7
MONTH = timedelta(days=30)
FIRST_UTC = datetime(2026, 1, 31, 12, tzinfo=UTC)


def write_calibration(root: Path, when: datetime, poses: PoseSet, *, serial: str = SERIAL) -> Path:
    session = ImportedSession(
        poses,
        arm=resolve("arm", "sarcos_dextrous"),
        fixture=resolve("fixture", "hinge"),
        file="poses.csv",
        name="hinge",
        serial_number=serial,
        clock=lambda: when,
    )
    solution = solve(session.state, session.procedure)
    session.add(solution, None)
    return session.write(root=root)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    root = tmp_path_factory.mktemp("sessions")
    reference, rng = load_poses(HINGE).poses, np.random.default_rng(11)
    for k in range(SESSIONS):
        chosen = np.sort(rng.choice(len(reference), 40, replace=False))
        q_deg = np.rad2deg(reference.q_rad[chosen]) + rng.normal(0.0, NOISE_DEG, (40, 7))
        q_deg[:, 3] -= SHIFT_DEG * (k >= SHIFTED_SESSION)
        poses = replace(reference.at_poses(chosen), q_rad=np.deg2rad(q_deg))
        write_calibration(root, FIRST_UTC + k * MONTH, poses)
    # The last poses again, and one session of another arm.
    write_calibration(root, FIRST_UTC + SESSIONS * MONTH, poses)
    write_calibration(root, FIRST_UTC, poses, serial="SDA-8")
    return root


@pytest.fixture
def history(run_command):
    """The command on these sessions: ``history(code, sessions, *words)``."""
    return lambda code, root, *arguments: run_command(
        code, "history", *arguments, "--sessions", root
    )


def test_scatter_that_no_sigma_explains_is_named_beside_the_verdict(sessions):
    """The arm is homed differently before each session: limits from this scatter call it in control."""
    past = arm_history(SERIAL, sessions)
    homed = [
        replace(c, document=_with_offset(c.document, "theta_off_3", deg))
        for c, deg in zip(past.calibrations[:5], (0.0, 1.8, -1.2, 0.9, -0.6), strict=True)
    ]
    text = " ".join(history_text(history_of(homed, ())).split())
    assert text.startswith("IN CONTROL: no entry has shifted. But sessions scatter")
    assert "theta_off_3 by 1." in text.split("limits are")[0]
    assert "theta_off_2" not in text.split("limits are")[0]
    steady = history_text(history_of(past.calibrations[:5], ()))
    assert steady.splitlines()[0] == "IN CONTROL: no entry has shifted."


def _with_offset(document: ParametersDocument, name: str, deg: float) -> ParametersDocument:
    row = int(name.rpartition("_")[2])
    dh = tuple(
        replace(r, theta_off_deg=r.theta_off_deg + deg) if k == row else r
        for k, r in enumerate(document.dh)
    )
    return replace(document, dh=dh)


def test_shifted_joint_is_reported_with_session_and_size(sessions, history):
    result = history(4, sessions, SERIAL, "--json").json
    assert result["verdict"] == "shifted"
    arm, *mounted = result["parts"]
    assert (arm["side"], len(arm["sessions"])) == ("arm", SESSIONS)
    assert sorted(arm["entries"]) == [f"theta_off_{j}" for j in range(2, 7)]
    assert [s["entry"] for s in arm["shifts"]] == ["theta_off_4"]
    (shift,) = arm["shifts"]
    assert shift["since"] == arm["sessions"][SHIFTED_SESSION]["session"]
    assert shift["size"] == pytest.approx(SHIFT_DEG, abs=4.0 * shift["sigma"])
    entry = arm["entries"]["theta_off_2"]
    # The scatter between sessions is below sigma, part of which is common to all sessions.
    assert 0.0 < entry["between"][-1] < entry["sigma"][-1]
    assert entry["type_a"][-1] < entry["sigma"][-1]
    # Ground and tool parameters are specific to each session.
    assert [len(part["sessions"]) for part in mounted] == [1, 1]
    assert result["left_out"] == [
        {"session": f"{FIRST_UTC + SESSIONS * MONTH:%Y%m%d-%H%M%S}-hinge",
         "why": f"the same poses as {arm['sessions'][-1]['session']}"}
    ]  # fmt: skip
    assert result["due"] == f"{FIRST_UTC + SESSIONS * MONTH:%Y-%m-%dT%H:%M:%SZ}"


def test_serial_number_is_optional_with_one_arm(sessions, tmp_path, history):
    assert "SDA-7, SDA-8" in history(2, sessions).err
    write_calibration(tmp_path, FIRST_UTC, load_poses(HINGE).poses, serial="SDA-9")
    assert "SDA-9: 1 accepted calibration" in history(0, tmp_path).out


def test_sessions_of_one_day_do_not_define_an_interval(tmp_path, history):
    poses = load_poses(HINGE).poses
    for k, chosen in enumerate((np.arange(40), np.arange(10, 50))):
        write_calibration(tmp_path, FIRST_UTC + k * timedelta(hours=1), poses.at_poses(chosen))
    out = history(0, tmp_path).out
    assert "2 accepted calibrations" in out
    assert f"due {FIRST_UTC + timedelta(days=365):%Y-%m-%d}" in out


def test_text_and_page_with_a_fixture_left_mounted(sessions, tmp_path, history):
    page = tmp_path / "history.html"
    out = history(4, sessions, SERIAL, "--kept-mounted", "--every", "90", "-o", page).out
    lines = out.splitlines()
    assert lines[0] == "SHIFTED:"
    assert max(len(line) for line in lines if not line.startswith("Page")) <= 80
    assert f"due {FIRST_UTC + (SESSIONS - 1) * MONTH + 3 * MONTH:%Y-%m-%d}" in out
    mounted = "Fixture on the table: fixture hinge, implicit, mounted 2026-01-31"
    assert f"{mounted}, {SESSIONS} sessions" in out
    text = page.read_text()
    assert text.count("<svg") == 14
    assert "theta_off_4 by " in text


def test_one_session_is_too_few_for_a_verdict(sessions, history):
    out = history(0, sessions, "SDA-8").out
    assert out.startswith("TOO EARLY TO JUDGE")
    assert "due 2027-01-31" in out
    result = history(0, sessions, "SDA-8", "--json", "--every", "1").json
    assert result["verdict"] == "too early to judge"
    assert "1 day after the last" in result["due_why"]


def test_failed_verification_makes_calibration_due_at_once(sessions):
    calibrations = arm_history("SDA-8", sessions).calibrations
    when = FIRST_UTC + 2 * MONTH
    for holds, due in ((True, FIRST_UTC + timedelta(days=365)), (False, when)):
        check = PastVerification(
            session=calibrations[0].session, utc=when, poses=6, holds=holds, position_m=1e-3, why=""
        )
        new_history = history_of(calibrations, [check])
        assert new_history.due.date() == due.date()
        assert ("DOES NOT HOLD" in history_text(new_history)) is not holds


def test_invalid_argument_is_one_error(sessions, tmp_path, history):
    unknown = tmp_path / "unknown"
    write_calibration(unknown, FIRST_UTC, load_poses(HINGE).poses, serial=UNKNOWN_SERIAL_NUMBER)
    for arguments, root, message in (
        ([], tmp_path / "none", "no sessions in"),
        ([], unknown, "with --serial"),
        (["SDA-9"], sessions, "erial numbers there: SDA-7, SDA-8"),
        (["SDA-9"], tmp_path / "none", "erial numbers there: none"),
        (["unstated"], sessions, "import with --serial"),
        ([SERIAL, "--every", "0"], sessions, "--every: 0 is not a number between 0 and 36500 days"),
    ):
        assert message in history(2, root, *arguments).err
