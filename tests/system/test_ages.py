"""What the app says of the age of its data: on the loopback bus, the controller in a process of its own.

With figures, longer and with a program that has no priority: python -m tests.benchmarks.ages
"""

from __future__ import annotations

import pytest

from tests.benchmarks.ages import Look, watched

pytestmark = [pytest.mark.needs("tmux"), pytest.mark.campaign, pytest.mark.real_time]


def test_fresh_data_are_not_called_old_and_a_late_computer_is_named() -> None:
    found, times = watched(12, "", ())
    assert [len(looks) for looks in found.values()] == [12, 12, 12, 20]
    for what, looks in found.items():
        assert not any(look.lost for look in looks), what
        # A look and its screen are two moments: what is old on one of them may be called so.
        assert stale(looks) <= sum(look.old for look in looks) + 1 + 5 * what.startswith("frozen")
    # On the screen it is said at most every half a minute; in the journal each of them counts.
    assert times >= 1


def stale(looks: list[Look]) -> int:
    return sum(look.stale for look in looks)
