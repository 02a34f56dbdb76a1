"""What a handler submits, whatever its guard has let through."""

from types import SimpleNamespace

import pytest

from operator_app.session.ui.action_handlers import go


@pytest.mark.parametrize("waypoint", [None, 0, 4])
def test_without_a_waypoint_nothing_moves(waypoint):
    refused, gone = list[str](), list[int]()
    context = SimpleNamespace(
        interface=SimpleNamespace(refuse=refused.append),
        submit=lambda _, work, __: work(SimpleNamespace(go=gone.append)),
    )
    go(context, waypoint)  # type: ignore[arg-type]
    assert gone == ([] if waypoint is None else [waypoint])
    assert len(refused) == (waypoint is None)
