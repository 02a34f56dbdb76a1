"""Answers of the drives to a SYNC, for tests of the monitors."""

from collections.abc import Sequence

from hardware.canopen.cyclic import Sample


def sample(
    statuses: Sequence[int],
    counts: Sequence[int] = (),
    *,
    sync: int = 1,
    missing: tuple[int, ...] = (),
    overdue: tuple[int, ...] = (),
) -> Sample:
    """Statuswords and counts (by default 0) of joints without torque."""
    zeros = (0,) * len(statuses)
    return Sample(
        sync_count=sync,
        statuswords=tuple(statuses),
        counts=tuple(counts) or zeros,
        torques_per_mille=zeros,
        missing=missing,
        overdue=overdue,
    )
