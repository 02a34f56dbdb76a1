"""Asks the system to run whoever keeps the time of an arm before other programs. Knows no bus and no arm."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

NICENESS: Final = -10
"""Of a program that sends SYNC to an arm, where it may choose: root may, and whom limits.conf allows it."""


@contextmanager
def first_in_line() -> Iterator[None]:
    """Run this thread, and the threads and processes it starts, before others; in turn where not allowed."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, min(before, NICENESS))
    except OSError:
        yield
        return
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)
