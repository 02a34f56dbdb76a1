"""The instrument that measures the tool of an open arm, pose by pose.

Its port delivers lines in the format of `operator_app.config.endpoint_line`. Lines of other poses are ignored.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable

from hardware.errors import InstrumentError
from hardware.line_port import GrowingFile, LinePort, StdinLines, TcpLines
from operator_app.config.endpoint_line import (
    EXAMPLE,
    BadLine,
    EndpointLine,
    read_json_line,
    read_row,
    require_heading,
)
from operator_app.config.resources import expanded
from operator_app.errors import SessionError
from solver.arrays import FloatArray

PATIENCE_S = 60.0
"""Timeout of one measurement: a person may have to turn the target towards the instrument."""
LOOK_S = 0.1
"""Interval at which `cancelled` is called."""
SOURCES = "tcp:HOST:PORT, file:PATH (CSV that grows) or stdin"


class TargetLostError(SessionError):
    """The instrument does not see the target at this pose; `why` is its message."""

    def __init__(self, why: str) -> None:
        self.why = why
        super().__init__(
            f"the tracker does not see its target at this pose: {why}",
            "go on with another pose, or turn the target towards the tracker and start a new session",
        )


class Instrument:
    """Measures the endpoint.

    Parameters
    ----------
    port
        Source of its lines.
    full_pose
        Whether it must measure the orientation.
    patience_s
        Timeout of one measurement.
    """

    def __init__(self, port: LinePort, *, full_pose: bool, patience_s: float = PATIENCE_S) -> None:
        self._port, self._full, self._patience_s = port, full_pose, patience_s
        self._heading = ""

    @property
    def name(self) -> str:
        """Name of its port."""
        return self._port.name

    def open(self) -> None:
        """Open the port; raises InstrumentError."""
        self._heading = self._port.open()
        if self._heading:
            try:
                require_heading(self._heading)
            except BadLine as error:
                raise InstrumentError(f"the heading of {self.name} {error}") from error

    def close(self) -> None:
        """Close the port. Safe to call twice."""
        self._port.close()

    def measure(
        self, pose: str, cancelled: Callable[[], bool] = lambda: False
    ) -> FloatArray | None:
        """Measure the target at the pose of this name.

        Returns
        -------
        Position (3,), m, or with orientation (6,), rotation vector in rad; None when cancelled.

        Raises
        ------
        InstrumentError
            It does not answer, or its line cannot be used.
        TargetLostError
            It does not see the target.
        """
        port = self._port
        port.ask(json.dumps({"measure": pose}))
        until_s = time.monotonic() + self._patience_s
        other = ""
        while True:
            if cancelled():
                return None
            left_s = until_s - time.monotonic()
            text = port.line(min(LOOK_S, max(left_s, 0.0))) or ""
            found = self._read(pose, text) if text.strip() else None
            if found is None or found.pose not in ("", pose):
                other = other if found is None else found.pose
                # Also for an instrument that sends only other poses.
                if left_s <= 0.0:
                    raise self._silent(pose, other)
                continue
            if found.lost:
                raise TargetLostError(found.lost)
            if self._full and len(found.endpoint) == 3:
                raise InstrumentError(
                    f"{self.name} sent no orientation for pose {pose}, and the fixture file states measures: "
                    f"pose. Let it send one of {EXAMPLE}; or write measures: position"
                )
            return found.endpoint if self._full else found.endpoint[:3]

    def _read(self, pose: str, text: str) -> EndpointLine:
        try:
            return read_row(self._heading, text) if self._heading else read_json_line(text)
        except BadLine as error:
            raise InstrumentError(f"what {self.name} sent for pose {pose} {error}") from error

    def _silent(self, pose: str, other: str) -> InstrumentError:
        said = f"; it sent pose {other}" if other else ""
        return InstrumentError(
            f"the tracker at {self.name} measured nothing for {self._patience_s:.0f} s at pose {pose}{said}. "
            "Check that it is on, sees its target and sends; then go on with this session: no pose is lost"
        )


def port_of(source: str) -> LinePort:
    """Return the port named by `source`; SessionError if the name is not valid."""
    kind, _, rest = source.partition(":")
    if source == "stdin":
        return StdinLines()
    if kind == "file" and rest:
        return GrowingFile(expanded(rest))
    match = re.fullmatch(r"(.+):(\d{1,5})", rest)
    if kind == "tcp" and match and 0 < int(match[2]) < 65536:
        return TcpLines(match[1].strip("[]"), int(match[2]))
    raise SessionError(f"{source!r} is not a port of a tracker", f"write {SOURCES}")
