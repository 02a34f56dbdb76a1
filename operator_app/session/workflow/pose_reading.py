"""Measures poses: waits for standstill, reads joint sensors and instrument, records the pose. Moves nothing.

The port of an instrument delivers lines in the format of `operator_app.config.measured_endpoints`. Lines for poses
that were not requested are ignored.
"""

import json
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hardware.arm import NO_LATENCY, ArmInterface, Reading
from hardware.errors import HardwareError, InstrumentError
from hardware.line_port import GrowingFile, LinePort, StdinLines, TcpLines
from operator_app.calibration.findings import motion_limit_rad
from operator_app.config.measured_endpoints import (
    ROTATION_EXAMPLE,
    BadLine,
    EndpointLine,
    read_json_line,
    read_row,
    require_heading,
)
from operator_app.config.quantities import degrees_for_file
from operator_app.config.resources import expanded
from operator_app.errors import GuardError, SessionError
from operator_app.session.safety.sensor_faults import SensorFaults, require_no_sensor_fault
from operator_app.session.store.logbook import Logbook
from operator_app.units import SCATTER
from solver.arrays import FloatArray
from solver.chain.sensors import Encoder

READINGS = 3
"""Number of times that a pose is read before the spread of its samples is an error."""
READING_TIMEOUT_S = 60.0
"""Timeout of one measurement, during which a person may have to turn the target towards the instrument."""
LINE_POLL_S = 0.1
"""Interval at which `go_on` is called."""
SOURCES = "tcp:HOST:PORT, file:PATH (a growing CSV file) or stdin"


class TargetLostError(SessionError):
    """The instrument does not see the target at this pose; `reason` is from the instrument."""

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"the tracker does not see its target at this pose: {reason}",
            "go on with another pose, or turn the target towards the tracker and start a new session",
        )


class Instrument:
    """An instrument that measures the endpoint.

    `full_pose`: whether a measurement must contain the orientation. `patience_s`: timeout of one measurement.
    """

    def __init__(
        self, port: LinePort, *, full_pose: bool, patience_s: float = READING_TIMEOUT_S
    ) -> None:
        self._port, self._full, self._patience_s = port, full_pose, patience_s
        self._heading = ""
        self._unanswered: Counter[str] = Counter()

    def open(self) -> None:
        """Open the port; raises InstrumentError if that fails or the instrument's header line is invalid."""
        self._heading = self._port.open()
        if self._heading:
            try:
                require_heading(self._heading)
            except BadLine as error:
                raise InstrumentError(f"the header line of {self._port.name} {error}") from error

    def close(self) -> None:
        """Close the port. May be called twice."""
        self._port.close()

    def measure(self, pose: str, go_on: Callable[[], None] = lambda: None) -> FloatArray:
        """Measure the target at the pose with the name `pose`; an exception that `go_on` raises ends the wait.

        If an earlier request for this pose was not answered in time, the new request contains a different name. A late
        answer to the earlier request is then ignored, since the arm may have moved in the meantime.

        Returns position (3,), m, or position and rotation vector (6,), m and rad. Raises InstrumentError if the
        instrument does not answer or its line cannot be used, and TargetLostError if it does not see the target.
        """
        port = self._port
        asked, before = pose, self._unanswered[pose]
        if port.sends_questions and before:
            pose = f"{pose} attempt {before + 1}"
        self._unanswered[asked] += 1
        port.ask(json.dumps({"measure": pose}))
        until_s = time.monotonic() + self._patience_s
        other = ""
        while True:
            go_on()
            left_s = until_s - time.monotonic()
            text = port.line(min(LINE_POLL_S, max(left_s, 0.0))) or ""
            endpoint = self._read(pose, text) if text.strip() else None
            if endpoint is None or endpoint.pose not in ("", pose):
                other = other if endpoint is None else endpoint.pose
                # The timeout also ends the wait if the instrument sends only other poses.
                if left_s <= 0.0:
                    raise self._silent(pose, other)
                continue
            self._unanswered[asked] = before
            if endpoint.lost:
                raise TargetLostError(endpoint.lost)
            if self._full and len(endpoint.endpoint) == 3:
                raise InstrumentError(
                    f"{self._port.name} sent no orientation for pose {pose}, and the fixture file states `measures: "
                    f"pose`. Let it send one of these groups: {ROTATION_EXAMPLE}; or write `measures: position` in "
                    "the fixture file"
                )
            return endpoint.endpoint if self._full else endpoint.endpoint[:3]

    def _read(self, pose: str, text: str) -> EndpointLine:
        try:
            return read_row(self._heading, text) if self._heading else read_json_line(text)
        except BadLine as error:
            raise InstrumentError(
                f"the line from {self._port.name} for pose {pose} {error}"
            ) from error

    def _silent(self, pose: str, other: str) -> InstrumentError:
        other_pose = f"; it sent one for pose {other}" if other else ""
        return InstrumentError(
            f"no measurement of pose {pose} arrived from the tracker at {self._port.name} within "
            f"{self._patience_s:.0f} s{other_pose}. No pose is lost. Check that the tracker is on, sees its target and "
            "is sending; then continue this session"
        )


def port_of(source: str) -> LinePort:
    """Return the port named by `source`; raises SessionError if the name is not valid."""
    kind, _, rest = source.partition(":")
    if source == "stdin":
        return StdinLines()
    if kind == "file" and rest:
        return GrowingFile(expanded(rest))
    match = re.fullmatch(r"(.+):(\d{1,5})", rest)
    if kind == "tcp" and match and 0 < int(match[2]) < 65536:
        return TcpLines(match[1].strip("[]"), int(match[2]))
    raise SessionError(f"{source!r} is not a tracker port", f"write {SOURCES}")


class PoseReader:
    """Measures the poses of one session.

    `go_on`: function that is called while the instrument measures, and raises Cancelled if the operator has cancelled.
    `recorded_latency` (attribute): the part of this connection's host latency that is already in the journal.
    """

    def __init__(
        self,
        logbook: Logbook,
        arm: ArmInterface,
        instrument: Instrument | None,
        go_on: Callable[[], None],
    ) -> None:
        self._logbook, self._arm = logbook, arm
        self._instrument, self._go_on = instrument, go_on
        self.sensor_faults = SensorFaults(logbook, arm)
        self.recorded_latency = NO_LATENCY
        self._rule = logbook.procedure.capture.settle

    def open_instrument(self) -> None:
        """On an open arm, open the instrument; raises SessionError if no port was specified for it."""
        if self._logbook.fixture.holds_hand:
            return
        if self._instrument is None:
            raise SessionError(
                f"the port of the instrument {self._logbook.procedure.fixture.name} is not stated",
                f"name its port: --tracker {SOURCES}; or tracker: in the procedure",
            )
        self._instrument.open()

    def close_instrument(self) -> None:
        """Close the instrument. May be called twice."""
        if self._instrument is not None:
            self._instrument.close()

    def settle(self) -> bool:
        """Wait for standstill; return False if it is not reached before the timeout."""
        with self.sensor_faults.recorded():
            return self._arm.settle(
                window=self._rule.window_syncs,
                spread_rad=self._rule.spread_rad(self._logbook.model),
                timeout_syncs=self._rule.timeout_syncs,
            )

    def _largest_spread_text(self) -> str:
        """Sample the joints again; return text about the joint farthest above its spread limit, "" if none is above."""
        limits = np.asarray(self._rule.spread_rad(self._logbook.model))
        try:
            rows = [self._arm.capture(2).mean_rad for _ in range(self._rule.window_syncs)]
        except HardwareError:
            return ""  # the caller reports that the arm does not settle
        spread = np.ptp(np.array(rows), axis=0)
        j = int(np.argmax(spread / limits))
        if spread[j] <= limits[j]:
            return ""
        spread_text, limit = (SCATTER(float(v)).with_unit for v in (spread[j], limits[j]))
        return f": joint {j + 1} spreads by {spread_text} within {2 * len(rows)} samples (limit {limit})"

    def read(self) -> Reading:
        """Wait for standstill and measure a pose; records nothing.

        Raises GuardError if the arm does not settle, or if each of `READINGS` attempts finds too much motion.
        """
        for _ in range(READINGS):
            if not self.settle():
                raise GuardError(
                    f"the arm does not come to rest{self._largest_spread_text()}",
                    "find what moves it, then capture again",
                )
            with self.sensor_faults.recorded():
                reading = self._arm.capture(self._logbook.procedure.capture.samples_per_pose)
            self.sensor_faults.read_until = self._arm.snapshot().sync_count
            spread = self._spread_text(reading)
            if not spread:
                return reading
        raise GuardError(
            f"the arm does not come to rest: {spread}",
            "find what moves it, or check the sensor of that joint, then capture again",
        )

    def _spread_text(self, reading: Reading) -> str:
        """Return text that names a joint whose samples spread more than the noise of its encoder; "" if none does.

        RVDTs are not tested, because their noise cannot be distinguished from motion in one reading.
        """
        unsensed = self._logbook.procedure.unsensed_joints
        for j, joint in enumerate(self._logbook.model.joints, 1):
            if isinstance(joint.sensor, Encoder) and j not in unsensed:
                spread = reading.sd_rad[j - 1 : j]
                limit = motion_limit_rad(joint.sensor, spread)
                if spread[0] > limit:
                    return (
                        f"{reading.samples} samples of joint {j} have a standard deviation of "
                        f"{SCATTER(float(spread[0])).with_unit} (limit {SCATTER(limit).with_unit})"
                    )
        return ""

    def keep(self, name: str, data: Mapping[str, Any]) -> None:
        """Measure a pose, and record an event `name` that contains `data` and the measurement."""
        logbook = self._logbook
        if name == "pose":
            require_no_sensor_fault(logbook.state, "captures are refused")
        reading = self.read()
        self.record_latency()
        self.sensor_faults.require_no_stuck_sensor(reading)
        what = f"{data.get('kind', '')} {data['number']}".strip()
        endpoint = self.endpoint(what, reading)
        placement = logbook.state.placement
        logbook.record(
            name,
            {
                **data,
                **({"placement": placement} if placement > 1 else {}),
                **({} if endpoint is None else {"endpoint": endpoint.tolist()}),
                # Rounded as in a poses file, so that poses.csv holds exactly these poses.
                "mean_rad": np.deg2rad(degrees_for_file(reading.mean_rad)).tolist(),
                "sd_rad": np.deg2rad(degrees_for_file(reading.sd_rad)).tolist(),
                "samples": reading.samples,
                "first_sync": reading.first_sync,
            },
        )

    def record_latency(self) -> None:
        """Record the host latencies (delays of this computer) that are not in the journal yet, if any."""
        late = self._arm.snapshot().lateness
        new = late.times - self.recorded_latency.times
        if new > 0:
            delays = {"last_s": late.last_s, "longest_s": late.longest_s}
            self._logbook.record("late", {"times": new, **delays})
        self.recorded_latency = late

    def endpoint(self, what: str, reading: Reading) -> FloatArray | None:
        """Measure the endpoint at the pose of `reading`; return None if the arm is not open or has no instrument.

        Returns position (3,), m, or position and rotation vector (6,), m and rad. `what`: name of the pose. Raises
        Cancelled, and GuardError if the arm moves during the measurement.
        """
        if self._logbook.fixture.holds_hand or self._instrument is None:
            return None
        endpoint = self._instrument.measure(what, self._go_on)
        turned = np.abs(self._arm.snapshot().positions_rad - reading.mean_rad)
        if np.any(turned > self._rule.spread_rad(self._logbook.model)):
            raise GuardError(
                f"joint {int(np.argmax(turned)) + 1} moved while the tracker measured",
                "find what moves the arm, then capture again",
            )
        return endpoint
