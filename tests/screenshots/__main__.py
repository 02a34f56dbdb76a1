"""Takes the screenshots of README and manual. Run: python -m tests.screenshots

The app runs without a terminal on the virtual arm over its bus. Keys are pressed from Connect to Results, and the
screen of every step is written to the manual as SVG, that of Capture during a planned move.
"""

import asyncio
import re
from contextlib import chdir
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.session.workflow.opening import Choices
from operator_app.tui.app import SarcalApp
from tests.operator_app.tui.conftest import running

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "operator_app/manual/pages/pictures"
SIZE = (120, 36)
SEED = 1
SPEED = 1.5
POSES_SHOWN = 12


async def main() -> None:
    """Go through all steps and write the screenshots."""
    # The screen shows the relative path sessions/.
    with TemporaryDirectory() as folder, chdir(folder):
        join = partial(open_arm, pace=Pace.REAL_TIME, speed=SPEED)
        source = Sessions("hinge_planned", Choices(seed=SEED), root=Path("sessions"), join=join)
        app = SarcalApp(lambda: source)
        try:
            async with running(app, SIZE) as driver:
                await driver.run("enter")
                await driver.until(lambda: driver.s.connected and driver.s.arm is not None)
                write(app, "connect")
                for step in (Step.FIXTURE, Step.MODES):
                    await driver.to_step(step)
                    write(app, step.title.lower())
                await driver.to_step(Step.CAPTURE)
                await driver.press("enter")
                await driver.until(lambda: in_planned_move(driver.s))
                write(app, "capture")
                await driver.idle()
                await driver.to_step(Step.RESULTS)
                write(app, "results")
        finally:
            source.close("pictures taken")


def in_planned_move(s: SessionSnapshot) -> bool:
    if len(s.state.used_poses) < POSES_SHOWN or s.heading is None or s.arm is None:
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
