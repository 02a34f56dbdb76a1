"""Signals that end a run."""

from __future__ import annotations

import subprocess
import sys

TWICE = """
import signal, sys
from operator_app.signals import ENDING, ending_signals_interrupt
try:
    with ending_signals_interrupt(), ending_signals_interrupt():
        signal.raise_signal(signal.SIGTERM)
except KeyboardInterrupt:
    for number in ENDING:
        signal.raise_signal(number)
    sys.exit(130)
"""


def test_a_second_signal_does_not_change_the_exit_code_of_an_interrupted_run() -> None:
    done = subprocess.run([sys.executable, "-c", TWICE], check=False, timeout=30)
    assert done.returncode == 130
