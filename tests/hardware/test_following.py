from __future__ import annotations

import pytest

from hardware.cyclic import Sample, Setpoint
from hardware.following import AWAY_SYNCS, Astray, Following

FOLLOWS, NO_ANSWER_BIT, STOPPED, FAULT = 0x1627, 0x0627, 0x1607, 0x1608
CSP, CST = 8, 10
WINDOW = 100


def watched(
    *away: int, status: int = FOLLOWS, mode: int = CSP, missing: tuple[int, ...] = ()
) -> list[Astray | None]:
    """What is said as joint 2 is `away` from its target, SYNC by SYNC."""
    following = Following([WINDOW, WINDOW])
    commands = (Setpoint(0x0F, 7, CSP), Setpoint(0x0F, 1000, mode))
    return [
        following.see(
            Sample(
                sync_count=sync,
                statuswords=(FOLLOWS, status),
                counts=(7, 1000 + counts),
                torques_per_mille=(0, 0),
                missing=missing,
            ),
            commands,
        )
        for sync, counts in enumerate(away, 50)
    ]


@pytest.mark.parametrize("away", [WINDOW + 1, -WINDOW - 1])
def test_a_joint_that_stays_away_is_named_with_how_far_and_since_when(away: int) -> None:
    said = watched(*[away] * (AWAY_SYNCS + 1))
    found = Astray(joint=2, counts=away, sync_count=50)
    assert said == [*[None] * (AWAY_SYNCS - 1), found, found]


def test_on_the_edge_of_its_window_it_is_where_it_should_be() -> None:
    assert set(watched(*[WINDOW, -WINDOW] * AWAY_SYNCS)) == {None}


def test_once_back_in_its_window_it_begins_anew() -> None:
    almost = [WINDOW + 50] * (AWAY_SYNCS - 1)
    assert set(watched(*almost, WINDOW, *almost)) == {None}


@pytest.mark.parametrize(
    "other",
    [
        {"status": NO_ANSWER_BIT},
        {"status": STOPPED},
        {"status": FAULT},
        {"mode": CST},
        {"missing": (1,)},
    ],
)
def test_only_a_drive_that_says_that_it_follows_is_taken_at_its_word(other: dict[str, int]) -> None:
    assert set(watched(*[5 * WINDOW] * 40, **other)) == {None}  # type: ignore[arg-type]


def test_nobody_is_astray_before_anything_was_commanded_or_without_windows() -> None:
    sample = Sample(sync_count=1, statuswords=(FOLLOWS,), counts=(9000,), torques_per_mille=(0,))
    for _ in range(3 * AWAY_SYNCS):
        assert Following([WINDOW]).see(sample, None) is None
        assert Following().see(sample, (Setpoint(0x0F, 0, CSP),)) is None
