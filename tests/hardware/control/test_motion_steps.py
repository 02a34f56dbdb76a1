from types import SimpleNamespace

import pytest

from hardware.control import motion_steps
from hardware.control.stop_line import StopLatch
from hardware.errors import Stopped


def test_stop_pressed_after_reset_request_stays_latched():
    latch, cleared = StopLatch(), list[None]()
    latch.press()
    press_to_reset = latch.last_press
    latch.press()
    loop = SimpleNamespace(latch=latch, commands=(), forget_faults=lambda: cleared.append(None))
    steps = motion_steps.reset(loop, press=press_to_reset)  # type: ignore[arg-type]
    with pytest.raises(Stopped, match="again"):
        next(steps)
    assert latch.latched
    assert cleared == []
    assert loop.commands == ()
