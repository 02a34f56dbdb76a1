"""The help text of `?`: the focused panel, the keys of the step, the keys that work everywhere."""

from __future__ import annotations

import textwrap

from operator_app.session.ui import actions
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import EVERYWHERE
from operator_app.tui.lines import Lines

ABOUT = {
    Step.CONNECT: "Find the arm on its bus and check that it is the right one and has one operator.",
    Step.FIXTURE: "Check that the fixture is mounted where its file states.",
    Step.MODES: "Choose which joints drive the closed chain and which follow.",
    Step.CAPTURE: "Move through the plan and read all joints at each pose while the arm stands still.",
    Step.CALIBRATE: "Find the parameters that close every loop.",
    Step.RESULTS: "Judge the calibration before anything is changed.",
    Step.EXPORT: "Write the parameters, upload them to the controller, verify with new poses.",
}


def help_text(step: Step, panel: Lines | None, width: int) -> str:
    """Return the text for a step and the focused panel, if one is."""
    blocks = [textwrap.fill(ABOUT[step], width)]
    if panel is not None and panel.HELP:
        blocks.append(textwrap.fill(f"This panel ({panel.TITLE}): {panel.HELP}", width))
    else:
        blocks.append("Tab focuses a panel; ? then explains that panel.")
    here = [a for a in actions.ACTIONS if step in a.steps and a.steps != EVERYWHERE]
    everywhere = [a for a in actions.ACTIONS if a.steps == EVERYWHERE]
    for title, some in (("Keys of this step", here), ("Keys everywhere", everywhere)):
        rows = [
            textwrap.fill(
                f"{a.shown:<9} {a.label}: {a.help}", width, initial_indent="  ",
                subsequent_indent=" " * 12,
            )
            for a in some
        ]  # fmt: skip
        blocks.append("\n".join([title, *rows]))
    return "\n\n".join(blocks)
