"""Takes the screenshots of README and manual. Run: python -m tests.screenshots

The app runs without a terminal on the virtual arm over its bus. Keys are pressed from Connect to Results, and the
screen of every step is written to the manual as SVG, that of Capture during a planned move.
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
    """Go through all steps and write the screenshots."""
    # The screen shows the relative path sessions/.
    with TemporaryDirectory() as folder, chdir(folder):
        join = partial(open_arm, pace=Pace.REAL_TIME, speed=SPEED)
        source = Sessions("hinge_planned", Choices(seed=SEED), root=Path("sessions"), join=join)
        app = SarcalApp(lambda: source)
        try:
            async with app.run_test(size=SIZE) as pilot:
                await wait_until(pilot, lambda: app.picture is not None)
                await pilot.press("enter")
                await wait_until(pilot, lambda: connected(app))
                write(app, "connect")
                for step in (Step.FIXTURE, Step.MODES):
                    await go_to_step(app, pilot, step)
                    write(app, step.title.lower())
                await go_to_step(app, pilot, Step.CAPTURE)
                await pilot.press("enter")
                await wait_until(pilot, lambda: in_planned_move(app))
                write(app, "capture")
                await wait_until(pilot, lambda: idle(app))
                await go_to_step(app, pilot, Step.CALIBRATE)
                await pilot.press("enter")
                await wait_until(pilot, lambda: app.step is Step.RESULTS and idle(app))
                await pilot.pause()
                write(app, "results")
        finally:
            source.close("pictures taken")


async def go_to_step(app: SarcalApp, pilot: Pilot[str], step: Step) -> None:
    """Press Enter until this step is shown."""
    while app.step is not step:
        await pilot.press("enter")
        if app.screen is not app.main:
            await pilot.press("y")
        await wait_until(pilot, lambda: idle(app))


async def wait_until(pilot: Pilot[str], condition: Callable[[], bool]) -> None:
    """Wait while the screen is repainted."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(str(app_state(pilot)))
        await asyncio.sleep(0.02)
    # Long enough to paint; the arm moves on.
    await pilot.pause(0.03)


def app_state(pilot: Pilot[str]) -> object:
    picture = getattr(pilot.app, "picture", None)
    return None if picture is None else picture.messages[-3:]


def idle(app: SarcalApp) -> bool:
    return app.runner is not None and app.runner.snapshot().task is None


def connected(app: SarcalApp) -> bool:
    s = app.picture
    return idle(app) and s is not None and s.connected and s.arm is not None


def in_planned_move(app: SarcalApp) -> bool:
    s = app.picture
    if s is None or len(s.state.used_poses) < POSES_SHOWN or s.heading is None or s.arm is None:
        return False
    trace = s.heading.trace_rad
    if trace is None or s.motion is None or s.motion.still:
        return False
    length = abs(trace[-1] - trace[0]).max()
    remaining = abs(trace[-1] - s.arm.positions_rad).max() / length
    return bool(0.3 < remaining < 0.7 and length > 0.5)


def write(app: SarcalApp, name: str) -> None:
    svg = re.sub(r"@font-face\s*{[^}]*}\s*", "", app.export_screenshot(title="sarcal"))
    path = PICTURES / f"{name}.svg"
    path.write_text(svg)
    print(path.relative_to(ROOT))


if __name__ == "__main__":
    asyncio.run(main())
