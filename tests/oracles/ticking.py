"""Reproducible time of day for journals."""

from datetime import UTC, datetime, timedelta


class TickingClock:
    def __init__(self) -> None:
        self._now = datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        self._now += timedelta(seconds=1)
        return self._now
