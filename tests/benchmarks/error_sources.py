# ruff: noqa: T201 - a benchmark prints
"""What each error source of `as_reported` leaves by itself. Run: python -m tests.benchmarks.error_sources

The README's table: the paper's estimator on 40 poses of the packaged hinge procedure, on the plant
without a bus, with one source of the scenario switched on at a time.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from hardware.virtual.scenarios import STIFF, Scenario, scenario
from operator_app.calibration.calibrate import calibrate
from operator_app.config.procedure_file import load_procedure
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from tests.oracles.opened import opened
from tests.oracles.plant_arm import PlantArm

ALL = scenario("as_reported")
QUIET = replace(ALL, curve_of_full_scale=0.0, lengths=None, loads=STIFF)
ROWS: tuple[tuple[str, Scenario], ...] = (
    ("RVDT curve", replace(QUIET, curve_of_full_scale=ALL.curve_of_full_scale)),
    ("fixed link lengths", replace(QUIET, lengths=ALL.lengths)),
    ("fixture that gives", replace(QUIET, loads=ALL.loads)),
    ("noise and counts", QUIET),
    ("all together", ALL),
)


def closure_sigmas(chosen: Scenario) -> tuple[float, float, float]:
    """sigma_pos (mm) and sigma_ori (mrad), rms, and the scaled condition number."""
    procedure = load_procedure("hinge")
    with tempfile.TemporaryDirectory() as folder:
        session = opened(Path(folder), PlantArm(procedure, chosen), procedure)
        session.connect()
        session.set_modes(procedure.position_joints or ())
        take_poses(session, Listener())
        found = calibrate(
            procedure.arm,
            procedure.fixture.fixture,
            session.state.pose_set(),
            estimator="paper",
        )
        session.close("done")
    sigmas = found.estimate.sigmas
    return (
        1e3 * sigmas.position_m.rms,
        1e3 * sigmas.orientation_rad.rms,
        found.seen.scaled_condition_number,
    )


def main() -> int:
    print(f"{'source':20} {'sigma_pos mm':>12} {'sigma_ori mrad':>14} {'condition':>9}")
    for name, chosen in ROWS:
        position, orientation, condition = closure_sigmas(chosen)
        print(f"{name:20} {position:12.2f} {orientation:14.2f} {condition:9.1f}")
    print("\nother specimens of the same sizes, all sources together")
    for specimen in range(6):
        position, orientation, _ = closure_sigmas(replace(ALL, specimen=specimen))
        print(f"{'specimen ' + str(specimen):20} {position:12.2f} {orientation:14.2f}")
    print("\npaper: sigma_pos 2.7 mm, sigma_ori 6.6 mrad, condition 28")
    return 0


if __name__ == "__main__":
    sys.exit(main())
