"""Measurement of a pose: standstill, joint sensors, instrument of an open arm, journal. Moves nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hardware.arm import Arm, Reading
from hardware.errors import HardwareError
from operator_app.config.quantities import degrees_for_file
from operator_app.errors import Cancelled, GuardError, SessionError
from operator_app.session.safety.latency import LatenessRecorder
from operator_app.session.safety.sensor_faults import SensorFaults
from operator_app.session.store.logbook import Logbook
from operator_app.session.workflow.instrument import SOURCES, Instrument
from operator_app.units.figure import SCATTER
from solver.arrays import FloatArray


class PoseReader:
    """Measures the poses of one session."""

    def __init__(
        self,
        logbook: Logbook,
        arm: Arm,
        *,
        sensor_faults: SensorFaults,
        lateness: LatenessRecorder,
        instrument: Instrument | None,
    ) -> None:
        self._logbook, self._arm = logbook, arm
        self._sensor_faults, self._lateness = sensor_faults, lateness
        self._instrument = instrument
        self._rule = logbook.procedure.capture.settle

    def open_instrument(self) -> None:
        """Open the instrument of an open arm."""
        if self._logbook.fixture.holds_hand:
            return
        if self._instrument is None:
            raise SessionError(
                f"{self._logbook.procedure.fixture.name} is an instrument, and its port is not known",
                f"name its port: --tracker {SOURCES}; or tracker: in the procedure",
            )
        self._instrument.open()

    def close_instrument(self) -> None:
        """Close the instrument. Safe to call twice."""
        if self._instrument is not None:
            self._instrument.close()

    def settle(self) -> bool:
        """Wait for standstill; False after the timeout."""
        with self._sensor_faults.recorded():
            return self._arm.settle(
                window=self._rule.window_syncs,
                spread_rad=self._rule.spread_rad(self._logbook.model),
                timeout_syncs=self._rule.timeout_syncs,
            )

    def _restless(self) -> str:
        """Return which joint exceeds its spread limit most, as text; "" if none does any more."""
        limits = np.asarray(self._rule.spread_rad(self._logbook.model))
        try:
            rows = [self._arm.capture(2).mean_rad for _ in range(self._rule.window_syncs)]
        except HardwareError:
            return ""  # the caller reports that the arm does not settle
        spread = np.ptp(np.array(rows), axis=0)
        j = int(np.argmax(spread / limits))
        if spread[j] <= limits[j]:
            return ""
        found, limit = (SCATTER(float(v)).with_unit for v in (spread[j], limits[j]))
        return f": joint {j + 1} spreads by {found} within {2 * len(rows)} samples (limit {limit})"

    def read(self) -> Reading:
        """Wait for standstill and measure a pose; records nothing."""
        if not self.settle():
            raise GuardError(
                f"the arm does not come to rest{self._restless()}",
                "check what moves or pushes it, then capture again",
            )
        with self._sensor_faults.recorded():
            reading = self._arm.capture(self._logbook.procedure.capture.samples_per_pose)
        self._sensor_faults.read_until = self._arm.snapshot().sync_count
        return reading

    def keep(self, name: str, data: Mapping[str, Any], cancelled: Callable[[], bool]) -> None:
        """Measure a pose and record it as an event of this name with these data."""
        logbook = self._logbook
        if name == "pose" and logbook.state.sensor_jump:
            raise GuardError(
                f"captures are refused: {logbook.state.sensor_jump}",
                "use the automatic capture: it measures the first pose again and goes on if that is unchanged; "
                "else start a new session",
            )
        reading = self.read()
        self._lateness.record()
        self._sensor_faults.require_no_stuck_sensor(reading)
        what = f"{data.get('kind', '')} {data['number']}".strip()
        endpoint = self.endpoint(what, reading, cancelled)
        placement = logbook.state.placement
        logbook.record(
            name,
            {
                **data,
                **({"placement": placement} if placement > 1 else {}),
                **({} if endpoint is None else {"endpoint": endpoint.tolist()}),
                # The angles a poses file can hold, so that poses.csv is these very poses.
                "mean_rad": np.deg2rad(degrees_for_file(reading.mean_rad)).tolist(),
                "sd_rad": np.deg2rad(degrees_for_file(reading.sd_rad)).tolist(),
                "samples": reading.samples,
                "first_sync": reading.first_sync,
            },
        )

    def endpoint(
        self, what: str, reading: Reading, cancelled: Callable[[], bool]
    ) -> FloatArray | None:
        """Return the tool measured by the instrument at this reading; None without an instrument."""
        if self._logbook.fixture.holds_hand or self._instrument is None:
            return None
        found = self._instrument.measure(what, cancelled)
        if found is None:
            raise Cancelled
        moved = np.abs(self._arm.snapshot().positions_rad - reading.mean_rad)
        if np.any(moved > self._rule.spread_rad(self._logbook.model)):
            raise GuardError(
                f"joint {int(np.argmax(moved)) + 1} moved while the tracker measured",
                "check what moves or pushes the arm, then capture again",
            )
        return found
