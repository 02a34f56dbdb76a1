"""A recording of the bus that a full disk ended: the arm goes on, and the operator is told."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from operator_app.composition import open_arm
from operator_app.session.opening import Choices, begin


@contextmanager
def files_end_after(size_bytes: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(("room_bytes", "told"), [(4096, True), (1 << 26, False)])
def test_a_recording_that_ended_early_is_told_when_the_arm_is_closed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], room_bytes: int, told: bool
) -> None:
    record_to = tmp_path / "bus.log"
    opening = begin("hinge", Choices(interface="virtual"), root=tmp_path)
    with files_end_after(room_bytes), open_arm(opening, record_to=record_to) as rig:
        assert rig.arm.connect().serial_number
    said = capsys.readouterr().err
    assert (f"{record_to}, ends early: " in said) is told
    assert ("Free some space" in said) is told
