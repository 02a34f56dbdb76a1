"""What drives answer to a SYNC, as the monitors are shown it. No test in it."""

from collections.abc import Sequence

from hardware.canopen.cyclic import Sample


def sample(
    statuses: Sequence[int],
    counts: Sequence[int] = (),
    *,
    sync: int = 1,
    missing: tuple[int, ...] = (),
) -> Sample:
    """Statuswords and counts of some joints; at 0 unless told otherwise, without torque."""
    zeros = (0,) * len(statuses)
    return Sample(
        sync_count=sync,
        statuswords=tuple(statuses),
        counts=tuple(counts) or zeros,
        torques_per_mille=zeros,
        missing=missing,
    )
