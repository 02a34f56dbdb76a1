from __future__ import annotations

import pytest

from hardware.canopen.cyclic import Sample, Setpoint
from hardware.monitors.following import DIVERGED_SYNCS, Divergence
from hardware.monitors.standstill import MAX_BRAKING_SYNCS, MIN_BRAKING_SYNCS, StandstillMonitor

STOPPED, ENABLED, OFF, FAULT = 0x1607, 0x1627, 0x0640, 0x1608
CSP, CST = 8, 10
WINDOW = 100
AT_REST = [500] * MIN_BRAKING_SYNCS


def watched(
    *counts: int, status: int = STOPPED, mode: int = CSP, missing: tuple[int, ...] = ()
) -> list[Divergence | None]:
    """What is said as joint 2, stopped at SYNC 50, stands at `counts`, SYNC by SYNC."""
    standing = StandstillMonitor([WINDOW, WINDOW])
    commands = (Setpoint(0x0F, 7, CSP), Setpoint(0x0F, 9000, mode))
    return [
        standing.update(
            Sample(
                sync_count=sync,
                statuswords=(STOPPED, status),
                counts=(7, position),
                torques_per_mille=(0, 0),
                missing=missing,
            ),
            commands,
        )
        for sync, position in enumerate(counts, 50)
    ]


@pytest.mark.parametrize("away", [WINDOW + 1, -WINDOW - 1])
def test_a_joint_that_goes_on_is_named_with_how_far_and_since_when(away: int) -> None:
    said = watched(*AT_REST, *[500 + away] * DIVERGED_SYNCS)
    found = Divergence(joint=2, counts=away, sync_count=50 + MIN_BRAKING_SYNCS, stopped=True)
    assert said == [*[None] * (len(said) - 1), found]


def test_coming_to_rest_is_no_motion() -> None:
    braking = [20_000 - 3 * k * k for k in range(MIN_BRAKING_SYNCS, 0, -1)]
    assert set(watched(*braking, *[20_000] * 40)) == {None}


@pytest.mark.parametrize("ramp_syncs", [50, 100, 190])
@pytest.mark.parametrize("steepness", [1, 7])
def test_a_drive_with_a_slow_quick_stop_is_let_come_to_rest(
    ramp_syncs: int, steepness: int
) -> None:
    """Its 6085h: with power taken away while it brakes, a joint without a brake would sink."""
    braking = [90_000 - steepness * k * k for k in range(ramp_syncs, 0, -1)]
    assert set(watched(*braking, *[90_000] * 60)) == {None}
    # And what it came to rest at is what it is held to.
    found = watched(*braking, *[90_000] * 40, *[90_000 + WINDOW + 1] * DIVERGED_SYNCS)[-1]
    assert found is not None
    assert found.counts == WINDOW + 1


@pytest.mark.parametrize("speed", [1, 5, 40])
def test_one_that_creeps_on_as_fast_as_before_is_not_waited_for(speed: int) -> None:
    creeping = [500 + speed * k for k in range(500)]
    said = watched(*creeping)
    told = next(k for k, found in enumerate(said) if found)
    assert told <= MIN_BRAKING_SYNCS + WINDOW // speed + DIVERGED_SYNCS


def test_one_that_seems_to_brake_for_ever_is_waited_for_2_s() -> None:
    slowing = [round(-2e5 * 0.997**k) for k in range(600)]
    told = next(k for k, found in enumerate(watched(*slowing)) if found)
    assert MAX_BRAKING_SYNCS < told < MAX_BRAKING_SYNCS + 20


def test_on_the_edge_of_its_window_it_stands_and_once_back_it_begins_anew() -> None:
    assert set(watched(*AT_REST, *[600, 400] * DIVERGED_SYNCS)) == {None}
    almost = [700] * (DIVERGED_SYNCS - 1)
    assert set(watched(*AT_REST, *almost, 500, *almost)) == {None}


@pytest.mark.parametrize(
    "other",
    [{"status": ENABLED}, {"status": OFF}, {"status": FAULT}, {"mode": CST}, {"missing": (2,)}],
)
def test_only_a_led_joint_whose_drive_says_that_it_holds_is_held_to_it(
    other: dict[str, int],
) -> None:
    assert set(watched(*AT_REST, *[5000] * 40, **other)) == {None}  # type: ignore[arg-type]


def test_a_joint_that_was_let_go_and_stopped_again_stands_where_it_is_now() -> None:
    standing = StandstillMonitor([WINDOW])

    def see(sync: int, status: int, counts: int) -> Divergence | None:
        sample = Sample(
            sync_count=sync, statuswords=(status,), counts=(counts,), torques_per_mille=(0,)
        )
        return standing.update(sample, (Setpoint(0x0F, 0, CSP),))

    way = [*[(STOPPED, 0)] * 40, (OFF, 500), *[(STOPPED, 9000)] * 80]
    assert {see(sync, *at) for sync, at in enumerate(way)} == {None}


def test_nothing_is_looked_at_before_anything_was_commanded() -> None:
    sample = Sample(sync_count=1, statuswords=(STOPPED,), counts=(9,), torques_per_mille=(0,))
    assert StandstillMonitor([WINDOW]).update(sample, None) is None
    assert StandstillMonitor().update(sample, (Setpoint(0x0F, 0, CSP),)) is None
