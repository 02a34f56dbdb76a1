from collections.abc import Iterable

import pytest

from hardware.arm import JointMode
from hardware.canopen.cyclic import MAX_LATE_SYNCS, Setpoint
from hardware.monitors.following import (
    DIVERGED_SYNCS,
    LAG_SYNCS,
    MAX_BRAKING_SYNCS,
    MIN_BRAKING_SYNCS,
    Divergence,
    FollowingMonitor,
)
from tests.oracles.samples import sample

FOLLOWS, NO_FOLLOWING_BIT, STOPPED, FAULT, OFF = 0x1627, 0x0627, 0x1607, 0x1608, 0x0640
CSP, CST = JointMode.POSITION, JointMode.FREE
WINDOW = 100
FIRST_SYNC = 50
TO_ZERO = Setpoint(0x0F, 0, CSP)


def first(divergences: tuple[Divergence, ...]) -> Divergence | None:
    return next(iter(divergences), None)


def follow(
    *errors: int, status: int = FOLLOWS, mode: JointMode = CSP, missing: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """Results from `FIRST_SYNC` on, with joint 2 at these distances from its target, SYNC by SYNC."""
    samples = (
        sample((FOLLOWS, status), (7, 1000 + error), sync=sync, missing=missing)
        for sync, error in enumerate(errors, FIRST_SYNC)
    )
    monitor = FollowingMonitor([WINDOW, WINDOW])
    targets = Setpoint(0x0F, 7, CSP), Setpoint(0x0F, 1000, mode)
    return [first(monitor.update(each, targets)) for each in samples]


def brake(
    *counts: int, status: int = STOPPED, mode: JointMode = CSP, missing: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """Results after a stop, with joint 2 at these positions, SYNC by SYNC."""
    samples = (
        sample((STOPPED, status), (7, position), sync=sync, missing=missing)
        for sync, position in enumerate(counts, FIRST_SYNC - MIN_BRAKING_SYNCS)
    )
    monitor = FollowingMonitor([WINDOW, WINDOW])
    targets = Setpoint(0x0F, 7, CSP), Setpoint(0x0F, 9000, mode)
    return [first(monitor.update(each, targets)) for each in samples]


def stand(
    *errors: int, status: int = STOPPED, mode: JointMode = CSP, missing: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """Results from `FIRST_SYNC` on, with joint 2 at these distances from its rest position, SYNC by SYNC."""
    counts = [500] * MIN_BRAKING_SYNCS + [500 + error for error in errors]
    results = brake(*counts, status=status, mode=mode, missing=missing)
    assert set(results[:MIN_BRAKING_SYNCS]) == {None}
    return results[MIN_BRAKING_SYNCS:]


BOTH = pytest.mark.parametrize("run", [follow, stand])
ENABLED_OR_STOPPED = pytest.mark.parametrize("status", [FOLLOWS, STOPPED])


@BOTH
@pytest.mark.parametrize("error", [WINDOW + 1, -WINDOW - 1])
@pytest.mark.parametrize("missing", [(), (1,)], ids=["all answer", "joint 1 does not answer"])
def test_divergence_has_size_and_first_sync(run, error, missing):
    divergence = Divergence(joint=2, counts=error, sync_count=FIRST_SYNC, stopped=run is stand)
    assert run(*[error] * (DIVERGED_SYNCS + 1), missing=missing) == [
        *[None] * (DIVERGED_SYNCS - 1),
        divergence,
        divergence,
    ]


@BOTH
def test_edge_of_window_and_short_excursions_are_no_divergence(run):
    assert set(run(*[WINDOW, -WINDOW] * DIVERGED_SYNCS)) == {None}
    excursion = [WINDOW + 50] * (DIVERGED_SYNCS - 1)
    assert set(run(*excursion, WINDOW, *excursion)) == {None}


@pytest.mark.parametrize(
    ("run", "options"),
    [
        *((follow, {"status": status}) for status in (NO_FOLLOWING_BIT, STOPPED, FAULT)),
        *((stand, {"status": status}) for status in (NO_FOLLOWING_BIT, OFF, FAULT)),
        *((run, {"mode": CST}) for run in (follow, stand)),
        *((run, {"missing": (2,)}) for run in (follow, stand)),
    ],
)
def test_joint_is_checked_only_in_position_mode_with_the_right_status(run, options):
    assert set(run(*[50 * WINDOW] * 40, **options)) == {None}


@ENABLED_OR_STOPPED
def test_every_diverged_joint_is_reported(status):
    monitor = FollowingMonitor([WINDOW, WINDOW])
    for errors, joints in (
        ((0, 0), set()),
        ((5 * WINDOW, 0), {1}),
        ((5 * WINDOW, 5 * WINDOW), {1, 2}),
    ):
        for sync in range(MIN_BRAKING_SYNCS):
            reported = monitor.update(
                sample((status, status), errors, sync=sync), (TO_ZERO, TO_ZERO)
            )
        assert {each.joint for each in reported} == joints


@ENABLED_OR_STOPPED
def test_nothing_is_checked_without_commands_or_windows(status):
    with_windows, without_windows = FollowingMonitor([WINDOW]), FollowingMonitor()
    for sync in range(MIN_BRAKING_SYNCS + 3 * DIVERGED_SYNCS):
        far = sample((status,), (9000 * (sync >= MIN_BRAKING_SYNCS),), sync=sync)
        assert with_windows.update(far, None) == ()
        assert without_windows.update(far, (TO_ZERO,)) == ()


@pytest.mark.parametrize("following_syncs", [1, 5])
def test_joint_stays_checked_when_bit_12_drops(following_syncs):
    monitor = FollowingMonitor([WINDOW])

    def update(sync: int, status: int, counts: int) -> Divergence | None:
        return first(monitor.update(sample((status,), (counts,), sync=sync), (TO_ZERO,)))

    for sync in range(following_syncs):
        assert update(sync, FOLLOWS, 0) is None
    results = [update(100 + k, NO_FOLLOWING_BIT, 5 * WINDOW) for k in range(DIVERGED_SYNCS)]
    assert results == [
        *[None] * (DIVERGED_SYNCS - 1),
        Divergence(joint=1, counts=5 * WINDOW, sync_count=100),
    ]
    # Stopped and enabled again, it is not checked until bit 12 is set.
    assert update(200, STOPPED, 5 * WINDOW) is None
    later = {update(201 + k, NO_FOLLOWING_BIT, 5 * WINDOW) for k in range(3 * DIVERGED_SYNCS)}
    assert later == {None}


def follow_path(
    path: Iterable[tuple[int, ...]], *, overdue: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """Results of one joint at these counts with these targets; a third number: whether its drive refuses them."""
    monitor = FollowingMonitor([WINDOW])
    return [
        first(
            monitor.update(
                sample((FOLLOWS,), (counts,), sync=sync, overdue=overdue),
                (Setpoint(0x0F, target, CSP),),
                (1,) if any(refuses) else (),
            )
        )
        for sync, (counts, target, *refuses) in enumerate(path)
    ]


def move(lag: int, *, offset: int = 0) -> list[Divergence | None]:
    """Results of a joint that moves 30 counts per SYNC forth and back, received `lag` SYNCs late."""
    targets = [*range(0, 6000, 30), *range(6000, 0, -30), *[0] * 200]
    path = ((targets[max(k - lag, 0)] + offset, target) for k, target in enumerate(targets))
    return follow_path(path, overdue=(lag,))


@pytest.mark.parametrize("lag", [0, 1, 23, MAX_LATE_SYNCS])
def test_receive_latency_is_no_divergence(lag):
    assert set(move(lag)) == {None}


@pytest.mark.parametrize("lag", [0, 23])
def test_divergence_during_motion_is_reported_at_rest_at_the_latest(lag):
    divergence = next(result for result in move(lag, offset=-WINDOW - 1) if result is not None)
    assert divergence.sync_count <= 400 + LAG_SYNCS + lag


def stall(speed_counts: int, **answers: tuple[int, ...]) -> tuple[int, Divergence]:
    """Return how many SYNCs after its stall a joint is reported, whose targets move on."""
    path = ((min(sync, 300) * speed_counts, sync * speed_counts) for sync in range(1000))
    results = enumerate(follow_path(path, **answers))
    return next((sync - 300, result) for sync, result in results if result is not None)


@pytest.mark.parametrize("speed_counts", [-200, 30])
def test_stalled_joint_is_reported_early_with_its_distance_from_the_target(speed_counts):
    syncs, divergence = stall(speed_counts)
    assert syncs <= LAG_SYNCS + WINDOW / abs(speed_counts) + DIVERGED_SYNCS + 1
    assert divergence.counts == -syncs * speed_counts


def refusal(counts: int) -> list[Divergence | None]:
    """Results of a joint that goes to `counts` after its drive has reported a refused target at 6000 counts."""
    return follow_path(
        (sync * 200 if sync <= 30 else counts, sync * 200, sync > 32) for sync in range(200)
    )


def test_refused_targets_are_no_divergence_as_long_as_the_joint_keeps_an_earlier_one():
    assert set(refusal(6000)) == set(refusal(6000 - 3 * WINDOW)) == {None}
    divergence = next(result for result in refusal(6600 + WINDOW) if result is not None)
    assert divergence.sync_count <= 40


def test_owed_answers_delay_the_report_of_a_stall():
    assert stall(200, overdue=(30,))[0] - stall(200)[0] == 30


@pytest.mark.parametrize("lag", [1, 5, LAG_SYNCS])
def test_servo_may_lag_in_motion(lag):
    path = [*[0] * lag, *range(0, 60_000, 200), *[60_000] * 100]
    assert set(follow_path(zip(path, path[lag:], strict=False))) == {None}


def test_joints_away_from_their_targets_or_silent_are_named():
    monitor = FollowingMonitor([WINDOW] * 4)
    commands = (TO_ZERO, TO_ZERO, Setpoint(0x0F, 0, CST), TO_ZERO)
    answer = sample((FOLLOWS,) * 4, (WINDOW, -WINDOW - 1, 9000, 0), missing=(4,))
    assert monitor.away(answer, commands) == (2, 4)
    assert FollowingMonitor().away(answer, commands) == ()


def test_targets_before_free_mode_are_forgotten():
    monitor = FollowingMonitor([WINDOW])

    def update(sync: int, target: int, mode: int) -> Divergence | None:
        return first(monitor.update(sample((FOLLOWS,), sync=sync), (Setpoint(0x0F, target, mode),)))

    assert update(1, 0, CSP) is None
    assert update(2, 0, CST) is None
    results = [update(sync, 5 * WINDOW, CSP) for sync in range(3, 3 + DIVERGED_SYNCS)]
    assert results[-1] == Divergence(joint=1, counts=-5 * WINDOW, sync_count=3)


@pytest.mark.parametrize(
    ("syncs", "factor"),
    [(MIN_BRAKING_SYNCS, 3), *((n, factor) for n in (50, 100, 190) for factor in (1, 7))],
)
def test_braking_joint_may_come_to_rest(syncs, factor):
    """Deceleration by 6085h: with power removed while it brakes, a joint without a brake would sink."""
    braking = [90_000 - factor * k * k for k in range(syncs, 0, -1)]
    assert set(brake(*braking, *[90_000] * 60)) == {None}
    # Its rest position is the reference.
    moved = [90_000 + WINDOW + 1] * DIVERGED_SYNCS
    assert brake(*braking, *[90_000] * 40, *moved)[-1].counts == WINDOW + 1


@pytest.mark.parametrize(
    ("counts", "earliest", "latest"),
    [
        *(
            ([s * k for k in range(500)], 0, MIN_BRAKING_SYNCS + WINDOW // s + DIVERGED_SYNCS)
            for s in (1, 5, 40)
        ),
        (
            [round(-2e5 * 0.997**k) for k in range(600)],
            MAX_BRAKING_SYNCS + 1,
            MAX_BRAKING_SYNCS + 19,
        ),
    ],
    ids=["1 per SYNC", "5 per SYNC", "40 per SYNC", "slowing for ever"],
)
def test_joint_that_does_not_come_to_rest_is_reported(counts, earliest, latest):
    index = next(k for k, divergence in enumerate(brake(*counts)) if divergence)
    assert earliest <= index <= latest


def test_second_stop_and_direct_enabling_begin_anew():
    monitor = FollowingMonitor([WINDOW])
    away = [(status, 9500) for status in (STOPPED, FOLLOWS) for _ in range(DIVERGED_SYNCS - 1)]
    answers = [*[(STOPPED, 0)] * 40, (OFF, 500), *[(STOPPED, 9000)] * 80, *away]
    for sync, (status, counts) in enumerate(answers):
        assert monitor.update(sample((status,), (counts,), sync=sync), (TO_ZERO,)) == ()
