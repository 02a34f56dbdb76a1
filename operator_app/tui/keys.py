"""Every action there is: its keys, words and where it applies. Footer, palette, help and dispatch read it.

Knows no widget and does nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

from operator_app.session.steps import Step

EVERYWHERE = frozenset(Step)
STOP_KEYS = ("space", "f8")
STOP_WIDTH = 16
"""Columns that STOP and its keys have at the left end of the strip, for the mouse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """Something the operator can do.

    Attributes
    ----------
    name
        ``action_<name>`` of the app does it.
    keys
        Key names as Textual gives them; `shown` is how they are printed.
    label, help
        One or two words for the footer; a sentence for palette and help.
    steps
        Where its keys work.
    """

    name: str
    keys: tuple[str, ...]
    shown: str
    label: str
    help: str
    steps: frozenset[Step] = EVERYWHERE


def _at(*steps: Step) -> frozenset[Step]:
    return frozenset(steps)


STOP = Action(
    name="stop", keys=STOP_KEYS, shown="SPACE/F8", label="STOP",
    help="Software STOP: quick stop to all drives, latched. F8 works everywhere, SPACE outside of "
    "text. It is not an emergency stop: that is the hardware button.",
)  # fmt: skip
PRIMARY = Action(
    name="primary", keys=("enter",), shown="Enter", label="Next thing",
    help="Do the next thing of this step, as the line above the footer says; when there is none, "
    "go on to the next step.",
)  # fmt: skip

ACTIONS: tuple[Action, ...] = (
    STOP,
    PRIMARY,
    Action(name="connect", keys=("c",), shown="c", label="Connect",
           help="Find the arm on the bus and check its identity.", steps=_at(Step.CONNECT)),
    Action(name="stop_tested", keys=("t",), shown="t", label="Stop tested",
           help="Confirm that the hardware stop was pressed and every drive dropped out.",
           steps=_at(Step.CONNECT)),
    Action(name="resume", keys=("o",), shown="o", label="Open session",
           help="Resume an earlier session.", steps=_at(Step.CONNECT, Step.EXPORT)),
    Action(name="procedure", keys=("p",), shown="p", label="Procedure",
           help="Take another procedure: fixture, drive joints, how poses are chosen. It begins a "
           "new session.", steps=_at(Step.CONNECT, Step.FIXTURE)),
    Action(name="check_fixture", keys=("k",), shown="k", label="Check again",
           help="Judge the fixture's placement again where the arm stands now.",
           steps=_at(Step.FIXTURE)),
    Action(name="tick", keys=("x",), shown="x", label="Tick",
           help="Tick the marked item of the check list.", steps=_at(Step.FIXTURE)),
    Action(name="toggle_mode", keys=("f",), shown="f", label="Free/Pos",
           help="Ask for the other mode of the marked joint; nothing happens until it is applied.",
           steps=_at(Step.MODES)),
    Action(name="suggest", keys=("p",), shown="p", label="Best pair",
           help="Mark the best ranked drive joints instead.", steps=_at(Step.MODES)),
    Action(name="apply_modes", keys=("a",), shown="a", label="Apply",
           help="Take control and set the modes as marked, after a question; they are read back.",
           steps=_at(Step.MODES)),
    Action(name="wiggle", keys=("w",), shown="w", label="Wiggle",
           help="Move each drive joint by 2 deg and back, to see what follows. Any key stops.",
           steps=_at(Step.MODES)),
    Action(name="automatic", keys=("a",), shown="a", label="Automatic",
           help="Move, settle and capture, pose after pose, until there are enough. Any key stops.",
           steps=_at(Step.CAPTURE)),
    Action(name="go", keys=("g",), shown="g", label="Go",
           help="Move to the next planned pose. Any key stops.", steps=_at(Step.CAPTURE)),
    Action(name="go_best", keys=("b",), shown="b", label="Go to best",
           help="Move to the pose that would tell most. Any key stops.", steps=_at(Step.CAPTURE)),
    Action(name="capture", keys=("c",), shown="c", label="Capture",
           help="Let the arm settle and capture a pose where it stands.", steps=_at(Step.CAPTURE)),
    Action(name="undo", keys=("u",), shown="u", label="Undo",
           help="Take back the last pose; the journal remembers it.", steps=_at(Step.CAPTURE)),
    Action(name="note", keys=("n",), shown="n", label="Note",
           help="Write a note to the marked pose.", steps=_at(Step.CAPTURE)),
    Action(name="exclude", keys=("x",), shown="x", label="Exclude",
           help="Leave the marked pose out of the calibration, or let it count again.",
           steps=_at(Step.CAPTURE)),
    Action(name="calibrate", keys=("s",), shown="s", label="Solve",
           help="Calibrate from the poses that count.", steps=_at(Step.CALIBRATE)),
    Action(name="estimator", keys=("e",), shown="e", label="Estimator",
           help="Change between the implicit and the paper's estimator.",
           steps=_at(Step.CALIBRATE)),
    Action(name="unsensed", keys=("j",), shown="j", label="Unsensed",
           help="Change which joints count as unsensed: none, each RVDT joint, all of them.",
           steps=_at(Step.CALIBRATE)),
    Action(name="cancel", keys=("z",), shown="z", label="Cancel",
           help="End the work in hand; a moving arm comes to rest and holds."),
    Action(name="write", keys=("w",), shown="w", label="Write file",
           help="Write parameters.yaml and poses.csv into the session folder.",
           steps=_at(Step.EXPORT)),
    Action(name="upload", keys=("u",), shown="u", label="Upload",
           help="Upload the parameters to the controller, after typing the arm's serial number; "
           "they are read back.", steps=_at(Step.EXPORT)),
    Action(name="verify", keys=("y",), shown="y", label="Verify",
           help="Move to new poses and judge them by the parameters found. Any key stops.",
           steps=_at(Step.EXPORT)),
    Action(name="report", keys=("r",), shown="r", label="Report",
           help="Write report.html, one page about this calibration, into the session folder.",
           steps=_at(Step.EXPORT)),
    Action(name="new_session", keys=("N",), shown="N", label="New session",
           help="Close this session, leave the arm held, and begin another.",
           steps=_at(Step.EXPORT)),
    Action(name="view", keys=("v",), shown="v", label="View",
           help="Show the next panel or plot of this step."),
    Action(name="next", keys=("right_square_bracket",), shown="]", label="Next",
           help="Go to the next step, if its conditions hold."),
    Action(name="back", keys=("left_square_bracket",), shown="[", label="Back",
           help="Go back a step; nothing is lost."),
    Action(name="down", keys=("down",), shown="Down", label="Down",
           help="Mark the next row of the list."),
    Action(name="up", keys=("up",), shown="Up", label="Up",
           help="Mark the row before."),
    Action(name="reset", keys=("R",), shown="R", label="Reset STOP",
           help="Clear a latched STOP or a drive fault. Nothing moves; the drives stay disabled."),
    Action(name="hold", keys=("H",), shown="H", label="Hold all",
           help="All joints to position mode where they are."),
    Action(name="help", keys=("question_mark", "f1"), shown="?", label="Help",
           help="Explain the focused panel and list the keys."),
    Action(name="palette", keys=("ctrl+p", "colon"), shown="Ctrl+P", label="All actions",
           help="Find any action by name."),
    Action(name="theme", keys=("T",), shown="T", label="Theme",
           help="Change between dark, light and no colour."),
    Action(name="quit", keys=("q", "ctrl+q", "ctrl+c"), shown="q", label="Quit",
           help="Leave, after a question: the arm is held, the session is kept."),
    *(
        Action(name=f"step({int(step)})", keys=(str(int(step)),), shown=str(int(step)),
               label=step.title, help=f"Go to step {int(step)}, {step.title}, if it is open.")
        for step in Step
    ),
)  # fmt: skip

FOOTER: dict[Step, tuple[str, ...]] = {
    Step.CONNECT: ("stop", "primary", "stop_tested", "resume", "help", "quit"),
    Step.FIXTURE: ("stop", "primary", "procedure", "back", "help", "quit"),
    Step.MODES: ("stop", "primary", "toggle_mode", "suggest", "wiggle", "help"),
    Step.CAPTURE: ("stop", "primary", "go", "capture", "undo", "help"),
    Step.CALIBRATE: ("stop", "primary", "estimator", "unsensed", "back", "help"),
    Step.RESULTS: ("stop", "primary", "view", "back", "help", "quit"),
    Step.EXPORT: ("stop", "primary", "verify", "report", "new_session", "help"),
}
"""At most six a step; everything else is in the palette and in help."""


def by_name(name: str) -> Action:
    """Return an action."""
    return next(a for a in ACTIONS if a.name == name)


def for_key(key: str, step: Step) -> Action | None:
    """Return what a key does at a step."""
    return next((a for a in ACTIONS if key in a.keys and step in a.steps), None)
