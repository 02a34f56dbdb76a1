"""The instrument that sees where the hand of an open arm is: asked pose by pose. Knows no arm and no journal.

Its port gives lines, which `operator_app.config.endpoint_line` reads. What it measured before it was asked
is of another pose, and so is what it says of one that was not asked for.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable

from hardware.errors import InstrumentError
from hardware.line_port import GrowingFile, LinePort, StdinLines, TcpLines
from operator_app.config.endpoint_line import (
    BadLine,
    EndpointLine,
    read_json_line,
    read_row,
    require_heading,
)
from operator_app.config.orientation import EXAMPLE
from operator_app.config.resources import expanded
from operator_app.errors import SessionError
from solver.arrays import FloatArray

PATIENCE_S = 60.0
"""How long it may take to measure one pose: somebody may have to turn the target towards it."""
LOOK_S = 0.1
"""How often the operator is asked meanwhile whether to go on."""
SOURCES = "tcp:HOST:PORT, file:PATH (CSV that grows) or stdin"


class TargetLostError(SessionError):
    """The instrument is well and does not see the target at this pose; `why` in its own words."""

    def __init__(self, why: str) -> None:
        self.why = why
        super().__init__(
            f"the tracker does not see its target here: {why}",
            "go on with another pose, or turn the target towards the tracker and start a new session",
        )


class Instrument:
    """What measures the endpoint.

    Parameters
    ----------
    port
        Where its lines come from.
    full_pose
        Whether it must say how the target is turned.
    patience_s
        How long it may take over a pose.
    """

    def __init__(self, port: LinePort, *, full_pose: bool, patience_s: float = PATIENCE_S) -> None:
        self._port, self._full, self._patience_s = port, full_pose, patience_s
        self._heading = ""

    @property
    def name(self) -> str:
        """Its port, in the words it was asked for."""
        return self._port.name

    def open(self) -> None:
        """Find it; InstrumentError says what to do where it is not there."""
        self._heading = self._port.open()
        if self._heading:
            try:
                require_heading(self._heading)
            except BadLine as error:
                raise InstrumentError(f"the heading of {self.name} {error}") from error

    def close(self) -> None:
        """Let go of it. Safe to call twice."""
        self._port.close()

    def measure(
        self, pose: str, cancelled: Callable[[], bool] = lambda: False
    ) -> FloatArray | None:
        """Ask where the target is now, the arm standing at what is called `pose`.

        Returns
        -------
        Position (3,), m, or with orientation (6,), rotation vector in rad; None when cancelled.

        Raises
        ------
        InstrumentError
            It is silent, or what it says cannot be used.
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
                # Also of one that never stops speaking of other poses.
                if left_s <= 0.0:
                    raise self._silent(pose, other)
                continue
            if found.lost:
                raise TargetLostError(found.lost)
            if self._full and len(found.endpoint) == 3:
                raise InstrumentError(
                    f"{self.name} did not say how the target is turned at pose {pose}, and the fixture file "
                    f"states measures: pose. Let it send one of {EXAMPLE}; or write measures: position"
                )
            return found.endpoint if self._full else found.endpoint[:3]

    def _read(self, pose: str, text: str) -> EndpointLine:
        try:
            return read_row(self._heading, text) if self._heading else read_json_line(text)
        except BadLine as error:
            raise InstrumentError(f"what {self.name} sent for pose {pose} {error}") from error

    def _silent(self, pose: str, other: str) -> InstrumentError:
        said = f"; it spoke of pose {other}" if other else ""
        return InstrumentError(
            f"the tracker at {self.name} measured nothing for {self._patience_s:.0f} s at pose {pose}{said}. "
            "See that it is on, sees its target and sends, then go on with this session: no pose is lost"
        )


def port_of(source: str) -> LinePort:
    """Return the port that `source` names; SessionError when it names none."""
    kind, _, rest = source.partition(":")
    if source == "stdin":
        return StdinLines()
    if kind == "file" and rest:
        return GrowingFile(expanded(rest))
    match = re.fullmatch(r"(.+):(\d{1,5})", rest)
    if kind == "tcp" and match and 0 < int(match[2]) < 65536:
        return TcpLines(match[1].strip("[]"), int(match[2]))
    raise SessionError(f"{source!r} is no port of a tracker", f"write {SOURCES}")
