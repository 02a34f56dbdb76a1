"""Screens contain only characters that a terminal shows, whatever a bus, a file or an operator wrote."""

import unicodedata
from dataclasses import replace

import pytest

from operator_app.session.ui.snapshot import Level, Message, SessionSnapshot
from operator_app.session.ui.steps import Step
from tests.oracles.story import story

HOSTILE = "a\x1b[2J\x1b]0;owned\x07b\x9b31mc\u202edlo\u2066x\ry\nz\u2028"
CONTROL_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")


def hostile(s: SessionSnapshot) -> SessionSnapshot:
    """The snapshot with hostile text in every external field."""
    nodes = tuple(replace(node, device_name=HOSTILE, role=HOSTILE) for node in s.identity.nodes)
    identity = replace(s.identity, model=HOSTILE, serial_number=HOSTILE, nodes=nodes)
    poses = tuple(
        replace(pose, note=HOSTILE, excluded=HOSTILE if pose.excluded else "")
        for pose in s.state.poses
    )
    state = replace(s.state, serial_number=HOSTILE, poses=poses)
    messages = tuple(
        Message(number=k, time="12:00:00", level=level, text=HOSTILE)
        for k, level in enumerate(Level, 1)
    )
    return replace(
        s, identity=identity, state=state, messages=messages, bus=HOSTILE, wiggle=HOSTILE,
        folder=s.folder / HOSTILE.replace("/", ""),
    )  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize("ascii_only", [False, True], ids=["all characters", "ascii"])
async def test_screens_contain_no_control_characters(still, ascii_only):
    snapshots = story()
    async with still(
        hostile(snapshots["connected"]), step=Step.CONNECT, ascii_only=ascii_only
    ) as d:
        shown = ""
        for step, name in ((Step.CONNECT, "connected"), (Step.CAPTURE, "capturing"),
                          (Step.RESULTS, "solved"), (Step.EXPORT, "written")):  # fmt: skip
            await d.show(hostile(snapshots[name]), step)
            if step is Step.CAPTURE:
                await d.press("n")
            strips = d.app.screen._compositor.render_strips()
            shown += "".join(segment.text for strip in strips for segment in strip)
            if d.app.screen is not d.app.main:
                await d.press("escape")
        assert "owned" in shown
        assert {c for c in shown if unicodedata.category(c) in CONTROL_CATEGORIES} == set()
