"""The steps of a reset."""

from types import SimpleNamespace

import pytest

from hardware.control import motion_steps
from hardware.control.stop_line import StopLatch
from hardware.errors import Stopped


def test_stop_pressed_after_reset_request_stays_latched():
    """STOP strikes after RESET was asked for and before the loop comes to it."""
    latch, cleared = StopLatch(), list[None]()
    latch.press()
    asked = latch.last_press
    latch.press()
    loop = SimpleNamespace(latch=latch, commands=())
    with pytest.raises(Stopped, match="again"):
        next(motion_steps.reset(loop, lambda: cleared.append(None), press=asked))  # type: ignore[arg-type]
    assert latch.latched
    assert cleared == []
    assert loop.commands == ()
