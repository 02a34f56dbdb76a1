"""An arm of another package: STOP takes precedence over commands, and invalid readings are refused."""

import math
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import wait as wait_for_futures
from dataclasses import replace
from functools import partial

import pytest
from sarcal import arms

from hardware.outside_arm import OutsideArm
from operator_app.composition import describe
from operator_app.config.arm_file import load_arm

ORDER = arms.ArmOrder(description=describe(load_arm("sarcos_dextrous")))
N = len(ORDER.description.joints)
HOME_RAD = [(joint.lower_rad + joint.upper_rad) / 2.0 for joint in ORDER.description.joints]
POSITION = [arms.JointMode.POSITION] * N


class PlainArm:
    """Executes every command, whatever came before, like many controllers."""

    def __init__(self) -> None:
        self.modes, self.on = list(POSITION), False
        self.before_executing: Callable[[], None] = lambda: None
        self.calls_watch = True

    def connect(self) -> arms.ArmIdentity:
        return arms.identity_of(ORDER, serial_number="PLAIN-1", speaks="Python")

    def close(self) -> bool:
        self.before_executing()
        return True

    def snapshot(self) -> arms.ArmSnapshot:
        return arms.snapshot_of(
            ORDER, HOME_RAD, sample=1, age_s=0.0, modes=self.modes, enabled=self.on
        )

    def take_control(self) -> None:
        self.before_executing()
        self.on = True

    def set_modes(self, modes: list[arms.JointMode]) -> None:
        self.before_executing()
        self.modes, self.on = list(modes), True

    def hold(self) -> None:
        self.set_modes(POSITION)

    def move(
        self, targets_rad: dict[int, float], *, speed_rad_per_s: float, watch: arms.Watch
    ) -> arms.MoveResult:
        self.before_executing()
        self.on = True
        reason = (watch(self.snapshot()) if self.calls_watch else None) or ""
        self.on_after_watch = self.on
        positions_rad = self.snapshot().positions_rad
        return arms.MoveResult(
            reached=not reason, reason=reason, positions_rad=positions_rad, syncs=1
        )

    def capture(self, samples: int) -> arms.Reading:
        return arms.reading_of(ORDER, [HOME_RAD] * samples, first_sample=1)

    def stop(self) -> None:
        self.on = False

    reset_stop = stop

    def upload_parameters(self, document: bytes) -> arms.UploadReceipt:
        self.document = document
        return arms.UploadReceipt(slot="A", sha256="", length=len(document), home_offset_counts=())


@pytest.fixture
def plain():
    return PlainArm()


@pytest.fixture
def arm(plain):
    arm = OutsideArm(arms.ArmOffer(make=lambda _: plain, says=""), ORDER, "the arm plain")
    arm.connect()
    yield arm
    arm.close()


COMMANDS: dict[str, Callable[[OutsideArm], object]] = {
    "take_control": OutsideArm.take_control,
    "set_modes": lambda arm: arm.set_modes(POSITION),
    "hold": OutsideArm.hold,
    "move": lambda arm: arm.move({1: HOME_RAD[0]}, speed_rad_per_s=0.1),
}


@pytest.mark.parametrize("calls_watch", [True, False])
@pytest.mark.parametrize("command", COMMANDS)
def test_stop_during_command_takes_precedence(arm, plain, command, calls_watch):
    arm.take_control()
    plain.before_executing, plain.calls_watch = arm.stop, calls_watch
    with pytest.raises(arms.Stopped, match="STOP was pressed: reset it"):
        COMMANDS[command](arm)
    assert not plain.on
    assert arm.snapshot().stopped
    if command == "move":
        assert plain.on_after_watch is not calls_watch, "stopped in the first call of the watch"


def test_stop_during_failing_command_stops_arm(arm, plain):
    def fail_after_stop() -> None:
        arm.stop()
        plain.on = True
        raise KeyError("enabled")

    plain.before_executing = fail_after_stop
    with pytest.raises(arms.Stopped):
        arm.take_control()
    assert not plain.on


def test_refused_mode_leaves_the_other_joints_held(arm, plain, monkeypatch):
    free = arms.JointMode.FREE

    def keep_joint_2_free(modes: list[arms.JointMode]) -> None:
        plain.modes = [free if at == 1 else mode for at, mode in enumerate(modes)]

    monkeypatch.setattr(plain, "set_modes", keep_joint_2_free)
    arm.take_control()
    with pytest.raises(arms.ModeNotReached, match="joint 2"):
        arm.set_modes([free, arms.JointMode.POSITION, *[free] * (N - 2)])
    assert plain.modes == [free if at == 1 else arms.JointMode.POSITION for at in range(N)]


@pytest.mark.parametrize("field", ["mean_counts", "mean_rad", "sd_rad"])
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([0.0, 0.0, math.nan] + [0.0] * (N - 3), "of joint 3 is nan"),
        ([0.0] * (N - 1), rf"has shape \({N - 1},\) instead of one value for each of {N} joints"),
    ],
    ids=["nan", "one missing"],
)
def test_invalid_reading_names_arm_and_joint(arm, plain, field, values, words):
    reading = replace(plain.capture(3), **{field: values})
    plain.capture = lambda _: reading
    with pytest.raises(arms.BusError, match=f"the arm plain: {field} {words}"):
        arm.capture(3)


@pytest.mark.parametrize("command", [OutsideArm.snapshot, COMMANDS["set_modes"], COMMANDS["move"]])
def test_invalid_snapshot_is_refused_in_every_command(arm, plain, command):
    arm.take_control()
    snapshot = plain.snapshot()
    first, second, *others = snapshot.joints
    infinite = replace(second, position_rad=math.inf)
    for joints, words in (
        (snapshot.joints[:-1], f"the arm plain has {N - 1} joints, and sarcos_dextrous has {N}"),
        ((first, infinite, *others), "the arm plain: position_rad of joint 2 is inf"),
    ):
        plain.snapshot = partial(replace, snapshot, joints=joints)
        with pytest.raises(arms.BusError, match=words):
            command(arm)


def test_stop_while_closing_reaches_arm(arm, plain):
    arm.take_control()
    plain.before_executing = arm.stop
    assert plain.on
    assert arm.close()
    assert not plain.on


def test_second_close_waits_for_first_close(arm, plain):
    closing, may_close = threading.Event(), threading.Event()

    def wait() -> None:
        closing.set()
        assert may_close.wait(60.0)

    plain.before_executing = wait
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(arm.close)
        assert closing.wait(60.0)
        second = pool.submit(arm.close)
        assert not wait_for_futures([first, second], timeout=0.05).done
        may_close.set()
        assert first.result(60.0)
        assert second.result(60.0)


def test_upload_enables_no_drive(arm, plain):
    assert arm.upload_parameters(b"table").length == len(plain.document)
    assert not plain.on
