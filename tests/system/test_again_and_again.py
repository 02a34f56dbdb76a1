"""Session after session on one controller: the arm stands wherever the last one left it, and the next works."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.buses import BusSettings
from hardware.canopen_arm import CanopenArm
from hardware.control_loop import Pace, Timing
from hardware.virtual.controller import VirtualController
from operator_app.calibration.verify import Prediction
from operator_app.cli import main
from operator_app.composition import carried_procedure, describe, run_controller
from operator_app.errors import GuardError
from operator_app.headless.runner import run
from operator_app.session.calibrated import calibrated
from operator_app.session.going_home import AT_THE_EDGE_RAD, go_home
from operator_app.session.listener import Listener
from operator_app.session.opening import Choices, Rig, begin, open_session, resume
from operator_app.session.session import Session
from operator_app.session.workflow import take_poses, verify

PATIENCE_S = 10.0
CHOICES = Choices(poses=10, scenario="datasheet", seed=0, interface="virtual")


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    channel = f"again-{os.getpid()}-{request.node.name[:16]}"
    settings = BusSettings(channel=channel)
    arm = begin("hinge", CHOICES, root=tmp_path).procedure.arm
    with run_controller(arm, CHOICES, settings, heartbeat_timeout_s=PATIENCE_S) as controller:
        yield Bench(controller, settings, tmp_path)


class Bench:
    """One controller, and sessions on it one after the other, each with a program of its own."""

    def __init__(self, controller: VirtualController, settings: BusSettings, root: Path) -> None:
        self.controller, self.settings, self.root = controller, settings, root
        self._count = 0

    @contextmanager
    def session(self, earlier: Path | None = None, **chosen: object) -> Iterator[Session]:
        self._count += 1
        if earlier is None:
            opening = begin("hinge", replace(CHOICES, **chosen), root=self.root)
            opening = replace(opening, folder=self.root / f"session-{self._count}")
        else:
            opening = resume(str(earlier), Choices(), root=self.root)
        opening = replace(opening, procedure=carried_procedure(opening))
        arm = CanopenArm(
            describe(opening.procedure.arm),
            self.settings,
            opening.procedure.profile,
            pace=Pace.FAST_FORWARD,
            timing=Timing(heartbeat_timeout_s=PATIENCE_S, lost_after_s=PATIENCE_S),
        )
        session = open_session(Rig(arm=arm, opening=opening, simulated=True))
        try:
            yield session
        finally:
            session.close("done")

    def calibrated(self) -> Path:
        with self.session() as session:
            result = run(session, Listener())
            assert result.solution.accepted, result.solution.reasons
            assert result.exported is not None
            return result.exported.folder

    def verified(self, folder: Path) -> Prediction:
        with self.session(folder) as session:
            session.connect()
            session.set_modes((1, 5))
            found, _ = verify(
                session, calibrated(session.state, session.procedure).solution, 4, Listener()
            )
            return found


def compared(a: Path, b: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    capsys.readouterr()
    code = main(["compare", str(a), str(b), "--json"])
    found = json.loads(capsys.readouterr().out)
    return code, found["drifted"]


def again_and_again(bench: Bench, capsys: pytest.CaptureFixture[str], *, times: int) -> None:
    folders = []
    for _ in range(times):
        folders.append(bench.calibrated())
        assert bench.verified(folders[-1]).holds
    assert compared(folders[0], folders[-1], capsys) == (0, [])

    # Somebody remounts the encoder of joint 3: 2000 counts are 1.8 deg.
    bench.controller.faults.lose_counts(3, -2000)
    after = bench.calibrated()
    assert compared(folders[-1], after, capsys) == (4, ["theta_off_3"])


def test_runs_and_verifications_on_one_controller_are_accepted_and_agree(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    again_and_again(bench, capsys, times=2)


@pytest.mark.campaign
def test_ten_in_a_row(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    again_and_again(bench, capsys, times=10)


def taken_to(session: Session, joint: int, deg: float) -> None:
    """Drive one joint elsewhere, as a person does who does not heed the procedure's box."""
    session.connect()
    session.set_modes((1, 5))
    moved = session.go_to({joint: float(np.deg2rad(deg))}, speed_rad_per_s=0.2)
    assert moved.reached, moved.reason


def test_an_arm_outside_its_box_is_not_moved_before_the_operator_agrees(bench: Bench) -> None:
    with bench.session() as session:
        taken_to(session, 5, -189.2465 + 12.0)
    with bench.session() as session:
        with pytest.raises(GuardError, match=r"joint 5 stands at .*, outside") as refused:
            run(session, Listener())
        assert "--go-home" in refused.value.remedy
        assert session.state.poses == ()
        here = session.arm.snapshot().positions_rad
        assert abs(np.rad2deg(here[4]) - (-189.2465 + 12.0)) < 0.1
    with bench.session(poses=4) as session:
        session.connect()
        end = take_poses(session, Listener(), (1, 5), homing=True)
        assert end is None
        assert len(session.state.poses) == 4


def test_home_is_home_and_recorded(bench: Bench) -> None:
    with bench.session() as session:
        taken_to(session, 1, 60.0)
        go_home(session)
        away = session.arm.snapshot().positions_rad - session.model.home_rad
        # The free joints follow; the paper's arm closes within a degree of its home.
        assert np.abs(away).max() < np.deg2rad(1.0)
        assert np.abs(away[[0, 4]]).max() < np.deg2rad(0.05)
        assert session.journal.path.read_text().count('"went_home"') == 1


def test_boxes_count_from_home_wherever_the_arm_stands(bench: Bench) -> None:
    with bench.session() as session:
        taken_to(session, 1, 20.0)
        from_afar = session.plan()
        box = session.box()
    with bench.session() as session:
        session.connect()
        session.set_modes((1, 5))
        assert session.plan() == from_afar
        assert session.state.start_rad is not None
        home = session.model.home_rad
        assert np.allclose(box.centre_rad, home[[0, 4]])
        for target in from_afar:
            for joint, low, high in ((1, -30.0, 48.0), (5, -70.0, 0.0)):
                assert np.deg2rad(low) <= target[joint] - home[joint - 1] <= np.deg2rad(high)
        beyond = session.box().beyond_rad(home + np.deg2rad(50.0))
        assert beyond.min() > AT_THE_EDGE_RAD or beyond[0] == pytest.approx(np.deg2rad(2.0))
