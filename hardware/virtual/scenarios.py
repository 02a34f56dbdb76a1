"""Named virtual arms: true geometry, sensor errors, fixture compliance.

If the tolerances of the arm and fixture files allow it, the true geometry is the paper's; otherwise it is drawn by seed
within these tolerances (`scenario_of`).

Each of the paper's three error sources (section 4: RVDTs, fixed lengths, fixture) is one field of a `Scenario`. The
errors are drawn from separate random streams, so that switching one off does not change the others.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from hardware.virtual import SCENARIOS, specimens, true_loop
from hardware.virtual.axis import LinearityDeviation, joint_sensor
from hardware.virtual.plant import Loads, Plant
from hardware.virtual.tracker import SimulatedTracker
from hardware.virtual.true_loop import Truth
from solver.arrays import frozen
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, Rvdt
from solver.loops.endpoints import MeasuredClosure

ENCODER_COUNTS_PER_REV = 400_000
"""Counts of the encoders of the paper's arm (section 3); scenario `exact` has such encoders on the wrist too."""


class _Stream(IntEnum):
    LENGTHS = 0
    CURVES = 1
    NOISE = 2
    WILD = 3
    SPECIMEN = 4
    TRACKER = 5
    MOUNTING = 6


STIFF = Loads(
    fixture_n_per_m=2e9,
    fixture_nm_per_rad=1e8,
    friction_nm=frozen(np.zeros(7)),
    payload_kg=frozen([0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]),
)
"""A fixture that deflects by less than 0.01 encoder count; the light load makes an arm sag if too few drives are on."""

COMPLIANT = Loads(
    fixture_n_per_m=2.5e4,
    fixture_nm_per_rad=8e2,
    friction_nm=frozen([2.4, 2.4, 2.0, 2.0, 1.2, 0.8, 0.8]),
    payload_kg=frozen([0.0, 0.0, 4.0, 0.0, 4.0, 0.0, 0.0]),
)
"""A slender fixture: weight and friction deflect it by about 2 mm and 3 mrad (at most 4 mm)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Description of a virtual arm in its fixture, from which `build` makes a plant.

    The same name and seed give the same arm and noise.
    """

    name: str
    seed: int
    truth: Truth
    specimen: int | None = None
    """Seed of the arm's linearity and length errors; if None, `seed` is used."""
    encoders_only: bool = False
    noise: bool = True
    linearity_of_full_scale: float = 0.0
    """Peak linearity deviation of each RVDT, as a fraction of full scale."""
    lengths: tuple[float, float] | None = None
    """Smallest and largest magnitude of random errors in the lengths that the maker states, m; None: no errors."""
    loads: Loads = STIFF
    placement: int = 1
    """Number of this mounting of the fixture, from 1; each mounting has different noise."""

    def arm(self, arm: ArmModel) -> ArmModel:
        """Return `arm` with the sensors of this scenario: those of `arm`, or encoders on all joints."""
        if not self.encoders_only:
            return arm
        encoder = Encoder(counts_per_rev=ENCODER_COUNTS_PER_REV)
        return replace(arm, joints=tuple(replace(j, sensor=encoder) for j in arm.joints))

    def true_loop(self) -> Truth:
        """Return the true geometry, including the length errors."""
        if self.lengths is None:
            return self.truth
        return true_loop.with_length_errors(self.truth, self.lengths, self._rng(_Stream.LENGTHS))

    def curves(self, arm: ArmModel) -> tuple[LinearityDeviation | None, ...]:
        """Return each joint's linearity deviation; None for an encoder, or if this scenario has no such deviations."""
        rng, peak = self._rng(_Stream.CURVES), self.linearity_of_full_scale
        return tuple(
            LinearityDeviation.drawn(rng, full_scale_rad=joint.sensor.full_scale_rad, peak=peak)
            if isinstance(joint.sensor, Rvdt) and peak > 0.0
            else None
            for joint in self.arm(arm).joints
        )

    def build(self, arm: ArmModel) -> Plant:
        """Make the plant, at rest at the closed pose nearest to home; `ValueError` if the loop does not close."""
        carried, truth = self.arm(arm), self.true_loop()
        sensors = [
            joint_sensor(joint, with_noise=self.noise, curve=curve)
            for joint, curve in zip(carried.joints, self.curves(arm), strict=True)
        ]
        return Plant(
            truth=truth,
            loads=self.loads,
            sensors=sensors,
            rng=self._rng(_Stream.NOISE),
            start_rad=truth.closed_near(carried.home_rad),
        )

    def tracker(self, plant: Plant, instrument: Measured) -> SimulatedTracker | None:
        """Return a tracker of an open arm, with the noise of `instrument`; None if the arm is in a fixture."""
        if not isinstance(plant.truth.loop, MeasuredClosure):
            return None
        rng = self._rng(_Stream.TRACKER)
        return SimulatedTracker(plant, plant.truth.loop, instrument, noise=self.noise, rng=rng)

    def _rng(self, stream: _Stream) -> np.random.Generator:
        measures = stream in (_Stream.NOISE, _Stream.TRACKER)
        seed = self.seed if measures or self.specimen is None else self.specimen
        again = [self.placement] if measures and self.placement > 1 else []
        return np.random.default_rng([seed, int(stream), *again])


def scenario(name: str, seed: int = 0) -> Scenario:
    """Return a scenario by name; `ValueError` for an unknown name or a negative seed."""
    if seed < 0:
        raise ValueError("a seed must be a whole number of at least 0")
    paper = Scenario(name=name, seed=seed, truth=true_loop.paper_loop())
    match name:
        case "exact":
            return replace(paper, encoders_only=True, noise=False)
        case "datasheet":
            return replace(paper, linearity_of_full_scale=0.02)
        case "as_reported":
            curved = replace(paper, specimen=8, linearity_of_full_scale=0.019)
            return replace(curved, lengths=(0.001, 0.002), loads=COMPLIANT)
        case "wild":
            truth = true_loop.draw_wild_loop(np.random.default_rng([seed, int(_Stream.WILD)]))
            return replace(paper, truth=truth, linearity_of_full_scale=0.02)
        case _:
            raise ValueError(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")


def scenario_of(
    name: str, seed: int, arm: ArmModel, fixture: EndpointConstraint, placement: int = 1
) -> Scenario:
    """Return the scenario `name` for an arm and a fixture.

    If the files can describe the paper's arm, the true arm is the paper's or, in ``wild``, drawn around the paper's.
    Otherwise `seed` determines a true arm within the tolerances of the files; in ``datasheet`` and ``wild``, lengths
    and twists that the calibration does not identify have errors too. Each `placement` is a mounting of the same arm.

    Raises `ValueError` if there is no such scenario, or if no plant can be built from these files.
    """
    mounted = scenario(name, seed)
    rng = np.random.default_rng([seed, int(_Stream.SPECIMEN)])
    if not specimens.files_allow(arm, fixture, true_loop.paper_loop(), true_loop.PAPER_HOME_RAD):
        truth = specimens.draw_truth(
            arm, fixture, rng, maker_errors=name != "exact" and mounted.lengths is None
        )
        mounted = replace(mounted, truth=truth, specimen=None, loads=mounted.loads.of(arm))
    elif not fixture.holds_hand:
        # The same arm as in the hinge, without the hinge.
        mounted = replace(mounted, truth=specimens.open_truth(arm, fixture, mounted.truth, rng))
    if placement == 1:
        return mounted
    rng = np.random.default_rng([seed, int(_Stream.MOUNTING), placement])
    truth = specimens.remount_truth(arm, fixture, mounted.truth, rng)
    return replace(mounted, truth=truth, placement=placement)
