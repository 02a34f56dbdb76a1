"""`sarcal history`: sessions in folders, months apart, of one arm whose joint 4 slips before the sixth."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from operator_app.calibration.history import PastVerification, history_of
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
SLIPPED_DEG, SINCE, SESSIONS = 0.3, 5, 7
MONTH = timedelta(days=30)
BEGAN = datetime(2026, 1, 31, 12, tzinfo=UTC)


def calibrated_on(root: Path, when: datetime, poses: PoseSet, *, serial: str = SERIAL) -> Path:
    session = ImportedSession(
        poses,
        arm=resolve("arm", "sarcos_dextrous"),
        fixture=resolve("fixture", "hinge"),
        file="poses.csv",
        name="hinge",
        serial_number=serial,
        clock=lambda: when,
    )
    found = solve(session.state, session.procedure, estimator="implicit", unsensed_joints=())
    session.add(found, None)
    return session.write(root=root)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    root = tmp_path_factory.mktemp("sessions")
    sound, rng = load_poses(HINGE).poses, np.random.default_rng(11)
    for k in range(SESSIONS):
        chosen = np.sort(rng.choice(len(sound), 40, replace=False))
        q_deg = np.rad2deg(sound.q_rad[chosen]) + rng.normal(0.0, NOISE_DEG, (40, 7))
        q_deg[:, 3] -= SLIPPED_DEG * (k >= SINCE)
        poses = PoseSet(
            placement=np.ones(40, dtype=np.int64),
            label=tuple(str(n) for n in range(1, 41)),
            q_rad=np.deg2rad(q_deg),
        )
        calibrated_on(root, BEGAN + k * MONTH, poses)
    # The last poses once more, and another arm's.
    calibrated_on(root, BEGAN + SESSIONS * MONTH, poses)
    calibrated_on(root, BEGAN, poses, serial="SDA-8")
    return root


@pytest.fixture
def history(ends_with):
    """The command on these sessions: ``history(code, sessions, *words)``."""
    return lambda code, root, *words: ends_with(code, "history", *words, "--sessions", root)


def test_a_slipped_joint_is_named_with_session_and_size(sessions, history):
    found = history(4, sessions, SERIAL, "--json").json
    assert found["verdict"] == "shifted"
    arm, *mounted = found["parts"]
    assert (arm["side"], len(arm["sessions"])) == ("arm", SESSIONS)
    assert sorted(arm["entries"]) == [f"theta_off_{j}" for j in range(2, 7)]
    assert [s["entry"] for s in arm["shifts"]] == ["theta_off_4"]
    (shift,) = arm["shifts"]
    assert shift["since"] == arm["sessions"][SINCE]["session"]
    assert shift["size"] == pytest.approx(SLIPPED_DEG, abs=4.0 * shift["sigma"])
    entry = arm["entries"]["theta_off_2"]
    # Between sessions the arm scatters less than sigma, of which a part is the same in all of them.
    assert 0.0 < entry["between"][-1] < entry["sigma"][-1]
    assert entry["type_a"][-1] < entry["sigma"][-1]
    # Ground and hand begin anew with each session.
    assert [len(part["sessions"]) for part in mounted] == [1, 1]
    assert found["left_out"] == [
        {"session": f"{BEGAN + SESSIONS * MONTH:%Y%m%d-%H%M%S}-hinge",
         "why": f"the same poses as {arm['sessions'][-1]['session']}"}
    ]  # fmt: skip
    assert found["due"] == f"{BEGAN + SESSIONS * MONTH:%Y-%m-%dT%H:%M:%SZ}"


def test_the_serial_may_be_left_out_where_there_is_one(sessions, tmp_path, history):
    assert "SDA-7, SDA-8" in history(2, sessions).err
    calibrated_on(tmp_path, BEGAN, load_poses(HINGE).poses, serial="SDA-9")
    assert "SDA-9: 1 accepted calibration" in history(0, tmp_path).out


def test_no_sessions_and_none_with_a_serial_number_are_two_answers(tmp_path, history):
    assert "no sessions in" in history(2, tmp_path).err
    calibrated_on(tmp_path, BEGAN, load_poses(HINGE).poses, serial=UNKNOWN_SERIAL_NUMBER)
    assert "with --serial" in history(2, tmp_path).err


def test_two_sessions_of_one_day_are_no_interval(tmp_path, history):
    poses = load_poses(HINGE).poses
    for k, chosen in enumerate((np.arange(40), np.arange(10, 50))):
        calibrated_on(tmp_path, BEGAN + k * timedelta(hours=1), poses.at_poses(chosen))
    out = history(0, tmp_path).out
    assert "2 accepted calibrations" in out
    assert f"due {BEGAN + timedelta(days=365):%Y-%m-%d}" in out


def test_text_page_and_what_stays_mounted(sessions, tmp_path, history):
    page = tmp_path / "history.html"
    out = history(4, sessions, SERIAL, "--kept-mounted", "--every", "90", "-o", page).out
    lines = out.splitlines()
    assert lines[0] == "SHIFTED:"
    assert max(len(line) for line in lines if not line.startswith("Page")) <= 80
    assert f"due {BEGAN + (SESSIONS - 1) * MONTH + 3 * MONTH:%Y-%m-%d}" in out
    assert (
        f"Fixture on the table: fixture hinge, implicit, mounted 2026-01-31, {SESSIONS} sessions"
        in out
    )
    text = page.read_text()
    assert text.count("<svg") == 14
    assert "theta_off_4 by " in text


def test_one_session_is_too_early_to_judge(sessions, history):
    out = history(0, sessions, "SDA-8").out
    assert out.startswith("TOO EARLY TO JUDGE")
    assert "due 2027-01-31" in out
    found = history(0, sessions, "SDA-8", "--json", "--every", "1").json
    assert found["verdict"] == "too early to judge"
    assert "1 day after the last" in found["due_why"]


def test_a_verification_that_did_not_hold_makes_the_next_due_at_once(sessions):
    past = arm_history("SDA-8", sessions).calibrations
    when = BEGAN + 2 * MONTH
    for holds, due in ((True, BEGAN + timedelta(days=365)), (False, when)):
        check = PastVerification(
            session=past[0].session, utc=when, poses=6, holds=holds, position_m=1e-3, why=""
        )
        found = history_of(past, [check])
        assert found.due.date() == due.date()
        assert ("DOES NOT HOLD" in history_text(found)) is not holds


def test_what_is_wrong_is_one_sentence(sessions, tmp_path, history):
    for words, root, said in (
        (["SDA-9"], sessions, "erial numbers there: SDA-7, SDA-8"),
        (["SDA-9"], tmp_path / "none", "erial numbers there: none"),
        (["unstated"], sessions, "import with --serial"),
        ([SERIAL, "--every", "0"], sessions, "--every 0: days"),
    ):
        assert said in history(2, root, *words).err
