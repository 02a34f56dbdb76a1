# ruff: noqa: T201 - says what it wrote
"""The pictures of README and manual, from the running app. Run: python -m tests.screenshots

The app itself, without a terminal, on the virtual arm over its bus: keys are pressed from Connect to
Results, and what the screen shows is written as SVG into the manual: every step as it is first seen,
Capture in the middle of a planned move.
"""

import asyncio
import re
import time
from collections.abc import Callable
from contextlib import chdir
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from textual.pilot import Pilot

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.steps import Step
from operator_app.session.workflow.opening import Choices
from operator_app.tui.app import SarcalApp

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "operator_app/manual/pages/pictures"
SIZE = (120, 36)
SEED = 1
SPEED = 1.5
PATIENCE_S = 300.0
POSES_SHOWN = 12


async def main() -> None:
    """Walk through, and write the pictures."""
    with (
        TemporaryDirectory() as folder,
        chdir(folder),
    ):  # a user sees sessions/, not a folder of this machine
        join = partial(open_arm, pace=Pace.REAL_TIME, speed=SPEED)
        source = Sessions("hinge_planned", Choices(seed=SEED), root=Path("sessions"), join=join)
        app = SarcalApp(lambda: source)
        try:
            async with app.run_test(size=SIZE) as pilot:
                await until(pilot, lambda: app.picture is not None)
                await pilot.press("enter")
                await until(pilot, lambda: connected(app))
                write(app, "connect")
                for step in (Step.FIXTURE, Step.MODES):
                    await walk(app, pilot, step)
                    write(app, step.title.lower())
                await walk(app, pilot, Step.CAPTURE)
                await pilot.press("enter")
                await until(pilot, lambda: under_way(app))
                write(app, "capture")
                await until(pilot, lambda: idle(app))
                await walk(app, pilot, Step.CALIBRATE)
                await pilot.press("enter")
                await until(pilot, lambda: app.step is Step.RESULTS and idle(app))
                await pilot.pause()
                write(app, "results")
        finally:
            source.close("pictures taken")


async def walk(app: SarcalApp, pilot: Pilot[str], step: Step) -> None:
    """Follow the footer."""
    while app.step is not step:
        await pilot.press("enter")
        if app.screen is not app.main:
            await pilot.press("y")
        await until(pilot, lambda: idle(app))


async def until(pilot: Pilot[str], holds: Callable[[], bool]) -> None:
    """Wait, with the screen repainted meanwhile."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > end:
            raise TimeoutError(str(app_state(pilot)))
        await asyncio.sleep(0.02)
    # A moment to paint, no more: the arm goes on.
    await pilot.pause(0.03)


def app_state(pilot: Pilot[str]) -> object:
    """What the session said last."""
    picture = getattr(pilot.app, "picture", None)
    return None if picture is None else picture.messages[-3:]


def idle(app: SarcalApp) -> bool:
    """Whether the worker has nothing to do."""
    return app.runner is not None and app.runner.snapshot().task is None


def connected(app: SarcalApp) -> bool:
    """Whether the arm is found, and its joints are on the screen."""
    s = app.picture
    return idle(app) and s is not None and s.connected and s.arm is not None


def under_way(app: SarcalApp) -> bool:
    """Whether the arm is well on its way to a planned pose, seen beforehand."""
    s = app.picture
    if s is None or len(s.state.used_poses) < POSES_SHOWN or s.heading is None or s.arm is None:
        return False
    way = s.heading.trace_rad
    if way is None or s.motion is None or s.motion.still:
        return False
    left = abs(way[-1] - s.arm.positions_rad).max() / abs(way[-1] - way[0]).max()
    return bool(0.3 < left < 0.7 and abs(way[-1] - way[0]).max() > 0.5)


def write(app: SarcalApp, name: str) -> None:
    """Write what the screen shows, without fonts to be fetched from elsewhere."""
    svg = re.sub(r"@font-face\s*{[^}]*}\s*", "", app.export_screenshot(title="sarcal"))
    path = PICTURES / f"{name}.svg"
    path.write_text(svg)
    print(path.relative_to(ROOT))


if __name__ == "__main__":
    asyncio.run(main())
