import pytest

from hardware.canopen.cyclic import MAX_LATE_SYNCS, Setpoint
from hardware.monitors.following import (
    DIVERGED_SYNCS,
    MAX_BRAKING_SYNCS,
    MIN_BRAKING_SYNCS,
    Divergence,
    FollowingMonitor,
    StandstillMonitor,
)
from tests.oracles.samples import sample

FOLLOWS, NO_ANSWER_BIT, STOPPED, FAULT = 0x1627, 0x0627, 0x1607, 0x1608
CSP, CST = 8, 10
WINDOW = 100


def watched(
    *away: int, status: int = FOLLOWS, mode: int = CSP, missing: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """What is said as joint 2 is `away` from its target, SYNC by SYNC."""
    following = FollowingMonitor([WINDOW, WINDOW])
    commands = (Setpoint(0x0F, 7, CSP), Setpoint(0x0F, 1000, mode))
    return [
        following.update(
            sample((FOLLOWS, status), (7, 1000 + counts), sync=sync, missing=missing), commands
        )
        for sync, counts in enumerate(away, 50)
    ]


@pytest.mark.parametrize("away", [WINDOW + 1, -WINDOW - 1])
def test_a_joint_that_stays_away_is_named_with_how_far_and_since_when(away):
    said = watched(*[away] * (DIVERGED_SYNCS + 1))
    found = Divergence(joint=2, counts=away, sync_count=50)
    assert said == [*[None] * (DIVERGED_SYNCS - 1), found, found]


def test_on_the_edge_of_its_window_it_is_where_it_should_be():
    assert set(watched(*[WINDOW, -WINDOW] * DIVERGED_SYNCS)) == {None}


def test_once_back_in_its_window_it_begins_anew():
    almost = [WINDOW + 50] * (DIVERGED_SYNCS - 1)
    assert set(watched(*almost, WINDOW, *almost)) == {None}


@pytest.mark.parametrize(
    "other",
    [
        {"status": NO_ANSWER_BIT},
        {"status": STOPPED},
        {"status": FAULT},
        {"mode": CST},
        {"missing": (2,)},
    ],
)
def test_only_a_drive_that_says_that_it_follows_is_taken_at_its_word(other):
    assert set(watched(*[5 * WINDOW] * 40, **other)) == {None}  # type: ignore[arg-type]


def test_a_joint_without_an_answer_hides_no_other():
    said = watched(*[5 * WINDOW] * DIVERGED_SYNCS, missing=(1,))
    assert said[-1] == Divergence(joint=2, counts=5 * WINDOW, sync_count=50)


def test_every_joint_that_diverges_is_named_though_the_first_goes_on_for_ever():
    following = FollowingMonitor([WINDOW, WINDOW])
    commands = (Setpoint(0x0F, 0, CSP), Setpoint(0x0F, 0, CSP))
    joints = []
    for sync in range(3 * DIVERGED_SYNCS):
        away = (5 * WINDOW, 5 * WINDOW if sync >= DIVERGED_SYNCS else 0)
        following.update(sample((FOLLOWS, FOLLOWS), away, sync=sync), commands)
        joints.append({each.joint for each in following.divergences})
    assert joints[DIVERGED_SYNCS] == {1}
    assert joints[-1] == {1, 2}


@pytest.mark.parametrize("shown", [1, 5])
def test_a_drive_that_has_followed_and_says_so_no_more_is_held_to_its_target(shown):
    following = FollowingMonitor([WINDOW])
    told = (Setpoint(0x0F, 0, CSP),)

    def see(sync: int, status: int, counts: int) -> Divergence | None:
        return following.update(sample((status,), (counts,), sync=sync), told)

    for sync in range(shown):
        assert see(sync, FOLLOWS, 0) is None
    said = [see(100 + sync, NO_ANSWER_BIT, 5 * WINDOW) for sync in range(DIVERGED_SYNCS)]
    assert said == [
        *[None] * (DIVERGED_SYNCS - 1),
        Divergence(joint=1, counts=5 * WINDOW, sync_count=100),
    ]
    # Stopped, and enabled anew: until it says that it follows it goes by no target.
    assert see(200, STOPPED, 5 * WINDOW) is None
    assert {see(201 + k, NO_ANSWER_BIT, 5 * WINDOW) for k in range(3 * DIVERGED_SYNCS)} == {None}


def test_no_joint_diverges_before_anything_was_commanded_or_without_windows():
    away = sample((FOLLOWS,), (9000,))
    for _ in range(3 * DIVERGED_SYNCS):
        assert FollowingMonitor([WINDOW]).update(away, None) is None
        assert FollowingMonitor().update(away, (Setpoint(0x0F, 0, CSP),)) is None


def moving(lag: int, *, offset: int = 0) -> list[Divergence | None]:
    """What is said of a joint that runs 30 counts a SYNC to and fro, seen `lag` SYNCs late."""
    following = FollowingMonitor([WINDOW])
    way = [*range(0, 6000, 30), *range(6000, 0, -30), *[0] * 200]
    return [
        following.update(
            sample((FOLLOWS,), (way[max(sync - lag, 0)] + offset,), sync=sync),
            (Setpoint(0x0F, target, CSP),),
        )
        for sync, target in enumerate(way)
    ]


@pytest.mark.parametrize("lag", [0, 1, 23, MAX_LATE_SYNCS])
def test_a_joint_seen_late_on_a_busy_machine_does_not_diverge(lag):
    assert set(moving(lag)) == {None}


@pytest.mark.parametrize("lag", [0, 23])
def test_a_joint_that_diverges_while_it_moves_is_found_when_it_rests_at_the_latest(lag):
    found = next(said for said in moving(lag, offset=-WINDOW - 1) if said is not None)
    assert found.sync_count <= 400 + 2 * MAX_LATE_SYNCS


def test_a_joint_that_was_free_meanwhile_has_been_told_nothing():
    following = FollowingMonitor([WINDOW])

    def see(sync: int, target: int, mode: int) -> Divergence | None:
        return following.update(sample((FOLLOWS,), sync=sync), (Setpoint(0x0F, target, mode),))

    assert see(1, 0, CSP) is None
    assert see(2, 0, CST) is None
    said = [see(sync, 5 * WINDOW, CSP) for sync in range(3, 3 + DIVERGED_SYNCS)]
    assert said[-1] == Divergence(joint=1, counts=-5 * WINDOW, sync_count=3)


ENABLED, OFF = 0x1627, 0x0640
AT_REST = [500] * MIN_BRAKING_SYNCS


def watched_after_stop(
    *counts: int, status: int = STOPPED, mode: int = CSP, missing: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """What is said as joint 2, stopped at SYNC 50, stands at `counts`, SYNC by SYNC."""
    standing = StandstillMonitor([WINDOW, WINDOW])
    commands = (Setpoint(0x0F, 7, CSP), Setpoint(0x0F, 9000, mode))
    return [
        standing.update(
            sample((STOPPED, status), (7, position), sync=sync, missing=missing), commands
        )
        for sync, position in enumerate(counts, 50)
    ]


def test_every_joint_that_goes_on_after_a_stop_is_named():
    standing = StandstillMonitor([WINDOW, WINDOW])
    commands = (Setpoint(0x0F, 0, CSP), Setpoint(0x0F, 0, CSP))
    for sync in range(MIN_BRAKING_SYNCS + DIVERGED_SYNCS):
        away = 5 * WINDOW if sync >= MIN_BRAKING_SYNCS else 0
        standing.update(sample((STOPPED, STOPPED), (away, away), sync=sync), commands)
    assert {each.joint for each in standing.divergences} == {1, 2}


@pytest.mark.parametrize("away", [WINDOW + 1, -WINDOW - 1])
def test_a_joint_that_goes_on_is_named_with_how_far_and_since_when(away):
    said = watched_after_stop(*AT_REST, *[500 + away] * DIVERGED_SYNCS)
    found = Divergence(joint=2, counts=away, sync_count=50 + MIN_BRAKING_SYNCS, stopped=True)
    assert said == [*[None] * (len(said) - 1), found]


def test_coming_to_rest_is_no_motion():
    braking = [20_000 - 3 * k * k for k in range(MIN_BRAKING_SYNCS, 0, -1)]
    assert set(watched_after_stop(*braking, *[20_000] * 40)) == {None}


@pytest.mark.parametrize("ramp_syncs", [50, 100, 190])
@pytest.mark.parametrize("steepness", [1, 7])
def test_a_drive_with_a_slow_quick_stop_is_let_come_to_rest(ramp_syncs, steepness):
    """Its 6085h: with power taken away while it brakes, a joint without a brake would sink."""
    braking = [90_000 - steepness * k * k for k in range(ramp_syncs, 0, -1)]
    assert set(watched_after_stop(*braking, *[90_000] * 60)) == {None}
    # And what it came to rest at is what it is held to.
    moved = [90_000 + WINDOW + 1] * DIVERGED_SYNCS
    found = watched_after_stop(*braking, *[90_000] * 40, *moved)[-1]
    assert found is not None
    assert found.counts == WINDOW + 1


@pytest.mark.parametrize("speed", [1, 5, 40])
def test_one_that_creeps_on_as_fast_as_before_is_not_waited_for(speed):
    creeping = [500 + speed * k for k in range(500)]
    said = watched_after_stop(*creeping)
    told = next(k for k, found in enumerate(said) if found)
    assert told <= MIN_BRAKING_SYNCS + WINDOW // speed + DIVERGED_SYNCS


def test_one_that_seems_to_brake_for_ever_is_waited_for_2_s():
    slowing = [round(-2e5 * 0.997**k) for k in range(600)]
    told = next(k for k, found in enumerate(watched_after_stop(*slowing)) if found)
    assert MAX_BRAKING_SYNCS < told < MAX_BRAKING_SYNCS + 20


def test_on_the_edge_of_its_window_it_stands_and_once_back_it_begins_anew():
    assert set(watched_after_stop(*AT_REST, *[600, 400] * DIVERGED_SYNCS)) == {None}
    almost = [700] * (DIVERGED_SYNCS - 1)
    assert set(watched_after_stop(*AT_REST, *almost, 500, *almost)) == {None}


@pytest.mark.parametrize(
    "other",
    [{"status": ENABLED}, {"status": OFF}, {"status": FAULT}, {"mode": CST}, {"missing": (2,)}],
)
def test_only_a_led_joint_whose_drive_says_that_it_holds_is_held_to_it(other):
    assert set(watched_after_stop(*AT_REST, *[5000] * 40, **other)) == {None}  # type: ignore[arg-type]


def test_a_joint_that_was_let_go_and_stopped_again_stands_where_it_is_now():
    standing, told = StandstillMonitor([WINDOW]), (Setpoint(0x0F, 0, CSP),)
    way = [*[(STOPPED, 0)] * 40, (OFF, 500), *[(STOPPED, 9000)] * 80]
    for sync, (status, counts) in enumerate(way):
        assert standing.update(sample((status,), (counts,), sync=sync), told) is None


def test_nothing_is_looked_at_before_anything_was_commanded():
    stopped = sample((STOPPED,), (9,))
    assert StandstillMonitor([WINDOW]).update(stopped, None) is None
    assert StandstillMonitor().update(stopped, (Setpoint(0x0F, 0, CSP),)) is None
