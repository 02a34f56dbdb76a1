"""Commands run in this process."""

from tests.oracles.answers import run_command

__all__ = ["run_command"]
