"""Commands run in this process."""

from tests.oracles.answers import ends_with

__all__ = ["ends_with"]
