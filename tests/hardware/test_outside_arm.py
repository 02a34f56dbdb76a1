"""An arm of another package: no command overtakes STOP, and no reading passes that is no number."""

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest
from sarcal import arms

from hardware.outside_arm import OutsideArm
from operator_app.composition import describe
from operator_app.config.arm_file import load_arm

DESCRIPTION = describe(load_arm("sarcos_dextrous"))
N = len(DESCRIPTION.joints)
HOME_RAD = [(joint.lower_rad + joint.upper_rad) / 2.0 for joint in DESCRIPTION.joints]
POSITION = [arms.JointMode.POSITION] * N


def nothing() -> None:
    """Happens while nothing happens."""


class PlainArm:
    """Does what it is told, whatever it was told before: the last command wins, as on many a controller."""

    def __init__(self) -> None:
        self.order = arms.ArmOrder(description=DESCRIPTION)
        self.angles = list(HOME_RAD)
        self.modes, self.on = list(POSITION), False
        self.meanwhile: Callable[[], None] = nothing  # between being told and doing it
        self.asks_the_watch = True

    def connect(self) -> arms.ArmIdentity:
        return arms.identity_of(self.order, serial_number="PLAIN-1", speaks="Python")

    def close(self) -> bool:
        self.meanwhile()
        return True

    def snapshot(self) -> arms.ArmSnapshot:
        return arms.snapshot_of(
            self.order, self.angles, sample=1, age_s=0.0, modes=self.modes, enabled=self.on
        )

    def take_control(self) -> None:
        self.meanwhile()
        self.on = True

    def set_modes(self, modes: list[arms.JointMode]) -> None:
        self.meanwhile()
        self.modes, self.on = list(modes), True

    def hold(self) -> None:
        self.set_modes(POSITION)

    def move(
        self, targets_rad: dict[int, float], *, speed_rad_per_s: float, watch: arms.Watch
    ) -> arms.MoveResult:
        self.meanwhile()
        self.on = True
        why = watch(self.snapshot()) if self.asks_the_watch else None
        self.on_after_the_watch = self.on
        return arms.MoveResult(
            reached=not why, reason=why or "", positions_rad=self.snapshot().positions_rad, syncs=1
        )

    def capture(self, samples: int) -> arms.Reading:
        return arms.reading_of(self.order, [self.angles] * samples, first_sample=1)

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
    made = OutsideArm(lambda: plain, DESCRIPTION, "the arm plain")
    made.connect()
    yield made
    made.close()


COMMANDS: dict[str, Callable[[OutsideArm], object]] = {
    "take_control": OutsideArm.take_control,
    "set_modes": lambda arm: arm.set_modes(POSITION),
    "hold": OutsideArm.hold,
    "move": lambda arm: arm.move({1: HOME_RAD[0]}, speed_rad_per_s=0.1),
}


@pytest.mark.parametrize("asks_the_watch", [True, False])
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_stop_during_command_takes_precedence(arm, plain, command, asks_the_watch):
    arm.take_control()
    plain.meanwhile, plain.asks_the_watch = arm.stop, asks_the_watch
    with pytest.raises(arms.Stopped, match="STOP was pressed: reset it"):
        command(arm)
    assert not plain.on
    assert arm.snapshot().stopped


def test_a_move_that_began_after_stop_is_stopped_at_its_first_look(arm, plain):
    arm.take_control()
    plain.meanwhile = arm.stop
    with pytest.raises(arms.Stopped):
        COMMANDS["move"](arm)
    assert not plain.on_after_the_watch


def test_stop_during_failing_command_stops_arm(arm, plain):
    def half_done() -> None:
        arm.stop()
        plain.on = True
        raise KeyError("enabled")

    plain.meanwhile = half_done
    with pytest.raises(arms.Stopped):
        arm.take_control()
    assert not plain.on


@pytest.mark.parametrize("what", ["mean_counts", "mean_rad", "sd_rad"])
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([0.0, 0.0, math.nan] + [0.0] * (N - 3), "of joint 3 is nan"),
        ([0.0] * (N - 1), rf"has shape \({N - 1},\) instead of one value for each of {N} joints"),
    ],
    ids=["nan", "one missing"],
)
def test_invalid_reading_names_arm_and_joint(arm, plain, what, values, words):
    right = plain.capture
    plain.capture = lambda samples: replace(right(samples), **{what: values})
    with pytest.raises(arms.BusError, match=f"the arm plain: {what} {words}"):
        arm.capture(3)


@pytest.mark.parametrize("command", [OutsideArm.snapshot, COMMANDS["set_modes"], COMMANDS["move"]])
def test_invalid_snapshot_is_refused_in_every_command(arm, plain, command):
    arm.take_control()
    whole = plain.snapshot()
    lost = replace(whole.joints[1], position_rad=math.inf)
    for joints, words in (
        (whole.joints[:-1], f"the arm plain has {N - 1} joints, and sarcos_dextrous has {N}"),
        (
            (whole.joints[0], lost, *whole.joints[2:]),
            "the arm plain: position_rad of joint 2 is inf",
        ),
    ):
        plain.snapshot = partial(replace, whole, joints=joints)
        with pytest.raises(arms.BusError, match=words):
            command(arm)


def test_stop_while_closing_reaches_arm(arm, plain):
    arm.take_control()
    plain.meanwhile = arm.stop
    assert plain.on
    assert arm.close()
    assert not plain.on


def test_second_close_waits_for_first_close(arm, plain):
    going, watch_on_the_way, answers = threading.Event(), threading.Event(), list[bool]()

    def wait() -> None:
        watch_on_the_way.set()
        assert going.wait(5.0)

    plain.meanwhile = wait
    threads = [
        threading.Thread(target=lambda: answers.append(arm.close()), daemon=True) for _ in range(2)
    ]
    threads[0].start()
    assert watch_on_the_way.wait(5.0)
    threads[1].start()
    threads[1].join(0.05)
    assert answers == []
    going.set()
    for thread in threads:
        thread.join(5.0)
    assert answers == [True, True]


def test_upload_enables_no_drive(arm, plain):
    assert arm.upload_parameters(b"table").length == len(plain.document)
    assert not plain.on
