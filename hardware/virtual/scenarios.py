"""Named virtual arms: a truth, what its sensors get wrong and how its fixture gives. Knows no bus.

The truth is the paper's arm in the paper's hinge where the files may mean that one; of any other arm or
fixture it is a specimen drawn by seed within what its files state (`scenario_of`).

The paper names three error sources (section 4): RVDTs, fixed lengths, fixture. Each is one field of
a `Scenario`, on or off with a stated size, drawn from its own stream of the seed, so that switching
one off leaves the others as they were.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from fixtures.measured import Measured
from hardware.virtual import SCENARIOS
from hardware.virtual.plant import Dynamics, Plant, fixture_stiffness
from hardware.virtual.sensors import RvdtCurve, SensorBank, joint_sensor
from hardware.virtual.specimens import Stated, drawn_truth, may_be, mounted_anew, opened
from hardware.virtual.tracker import SimulatedTracker
from hardware.virtual.truth import (
    PAPER_HOME_RAD,
    OpenTruth,
    Truth,
    WildSpread,
    paper_loop,
    wild_loop,
    with_length_errors,
)
from solver.arrays import FloatArray, frozen
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, Rvdt

ENCODER_COUNTS_PER_REV = 400_000
"""The arm's encoders (paper, section 3); scenario `exact` has them on the wrist as well."""

GRAVITY_M_PER_S2 = 9.81
PAPER_DOWN = frozen([-1.0, 0.0, 0.0])
"""In frame 0, the arm's base: z_0, the first shoulder axis, is level."""
UPRIGHT_DOWN = frozen([0.0, 0.0, -1.0])
"""Of an arm whose file does not say which way is down: its first axis stands upright."""
PAPER_TORQUE_NM = 100.0
"""What the drives of the paper's arm can do, by its file."""


class _Stream(IntEnum):
    """Independent random streams of one seed."""

    LENGTHS = 0
    CURVES = 1
    NOISE = 2
    WILD = 3
    SPECIMEN = 4
    TRACKER = 5
    MOUNTING = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthErrors:
    """Lengths taken from the maker's table are off by `smallest_m` to `largest_m`, either way."""

    smallest_m: float
    largest_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Loads:
    """Stiffness of the fixture and the forces that bend it.

    Attributes
    ----------
    fixture_n_per_m, fixture_nm_per_rad
        Stiffness, alike in every direction.
    friction_nm
        Dry friction of each joint, shape (n,).
    payload_kg
        Uncompensated mass at the origin of each frame, shape (n,).
    down
        (3,) unit vector along gravity in frame 0.
    """

    fixture_n_per_m: float
    fixture_nm_per_rad: float
    friction_nm: FloatArray
    payload_kg: FloatArray
    down: FloatArray = field(default_factory=lambda: PAPER_DOWN)

    def __post_init__(self) -> None:
        for name in ("friction_nm", "payload_kg", "down"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def of(self, arm: ArmModel) -> Loads:
        """The same for another arm: masses halfway along it, masses and friction in proportion to its drives.

        Of masses the weakest drive counts: in a closed chain any of them may come to carry them.
        """
        weakest = min(joint.max_torque_nm for joint in arm.joints) / PAPER_TORQUE_NM
        n, payload = arm.joint_count, self.payload_kg * min(1.0, weakest)
        if n == len(payload):
            placed, friction = payload, self.friction_nm
        else:
            placed, friction = np.zeros(n), np.zeros(n)
            placed[[n // 2 - 1, max(n - 3, 0)]] = float(payload.max())
        if np.any(self.friction_nm > 0.0):
            share = self.friction_nm.max() / PAPER_TORQUE_NM
            friction = share * np.array([joint.max_torque_nm for joint in arm.joints])
        down = UPRIGHT_DOWN if arm.masses is None else arm.masses.down
        return replace(self, payload_kg=placed, friction_nm=friction, down=down)


STIFF = Loads(
    fixture_n_per_m=2e9,
    fixture_nm_per_rad=1e8,
    friction_nm=frozen(np.zeros(7)),
    payload_kg=frozen([0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]),
)
"""A fixture that gives less than a hundredth of an encoder count. The light load makes an arm with
too few drives sag."""

YIELDING = Loads(
    fixture_n_per_m=2.5e4,
    fixture_nm_per_rad=8e2,
    friction_nm=frozen([2.4, 2.4, 2.0, 2.0, 1.2, 0.8, 0.8]),
    payload_kg=frozen([0.0, 0.0, 4.0, 0.0, 4.0, 0.0, 0.0]),
)
"""A slender fixture, which weight and friction bend by about 2 mm and 3 mrad (4 mm at most)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A virtual arm in its fixture: frozen description, from which `build` makes a plant.

    Attributes
    ----------
    name, seed
        The same name and seed are the same arm and the same noise.
    specimen
        Seed of the arm's own errors, curves and lengths: which of all arms of this kind it is.
        None takes `seed`.
    truth
        True geometry before length errors; any truth may be given.
    encoders_only
        Every joint, the wrist's too, carries a 400,000-count encoder.
    noise
        Whether sensors have the noise their description states.
    curve_of_full_scale
        Peak deviation of every RVDT from its best-fit line, fraction of full scale; 0 is off.
    lengths
        Errors of the fixed lengths; None is off.
    loads
        Fixture stiffness and loads.
    placement
        For which time the fixture is mounted; each has noise of its own.
    """

    name: str
    seed: int
    truth: Truth
    specimen: int | None = None
    encoders_only: bool = False
    noise: bool = True
    curve_of_full_scale: float = 0.0
    lengths: LengthErrors | None = None
    loads: Loads = STIFF
    placement: int = 1

    def arm(self, arm: ArmModel) -> ArmModel:
        """Return `arm` with the sensors that this virtual arm really carries."""
        if not self.encoders_only:
            return arm
        encoder = Encoder(counts_per_rev=ENCODER_COUNTS_PER_REV)
        return replace(arm, joints=tuple(replace(j, sensor=encoder) for j in arm.joints))

    def true_loop(self) -> Truth:
        """Geometry with the length errors in."""
        if self.lengths is None:
            return self.truth
        return with_length_errors(
            self.truth,
            smallest_m=self.lengths.smallest_m,
            largest_m=self.lengths.largest_m,
            rng=self._rng(_Stream.LENGTHS),
        )

    def curves(self, arm: ArmModel) -> tuple[RvdtCurve | None, ...]:
        """RVDT curve of every joint of `arm`; None for encoders and when curves are off."""
        rng = self._rng(_Stream.CURVES)
        return tuple(
            RvdtCurve.drawn(
                rng,
                full_scale_rad=joint.sensor.full_scale_rad,
                peak=self.curve_of_full_scale,
            )
            if isinstance(joint.sensor, Rvdt) and self.curve_of_full_scale > 0.0
            else None
            for joint in self.arm(arm).joints
        )

    def build(self, arm: ArmModel) -> Plant:
        """Make the plant, at rest at the closed pose nearest to the arm's home.

        Raises
        ------
        ValueError
            If the arm has another number of joints than the truth, or does not close there.
        """
        carried, truth = self.arm(arm), self.true_loop()
        if carried.joint_count != truth.joint_count:
            raise ValueError(
                f"scenario {self.name!r} has {truth.joint_count} joints,"
                f" the arm file {carried.joint_count}"
            )
        sensors = [
            joint_sensor(joint, with_noise=self.noise, curve=curve)
            for joint, curve in zip(carried.joints, self.curves(arm), strict=True)
        ]
        start, hinge = truth.closed_near(carried.home_rad)
        return Plant(
            truth=truth,
            dynamics=Dynamics(
                fixture=fixture_stiffness(
                    n_per_m=self.loads.fixture_n_per_m,
                    nm_per_rad=self.loads.fixture_nm_per_rad,
                    components=len(truth.point().error),
                ),
                payload_kg=self.loads.payload_kg,
                gravity_m_per_s2=GRAVITY_M_PER_S2 * self.loads.down,
                friction_nm=self.loads.friction_nm,
            ),
            sensors=SensorBank(sensors, rng=self._rng(_Stream.NOISE)),
            start_rad=start,
            start_hinge_rad=hinge,
        )

    def tracker(self, plant: Plant, instrument: Measured) -> SimulatedTracker | None:
        """What sees the hand of this plant, as exact as `instrument` is stated; None where a fixture holds it."""
        truth = plant.truth
        if not isinstance(truth, OpenTruth):
            return None
        exactly = 1.0 if self.noise else 0.0
        return SimulatedTracker(
            truth,
            lambda: plant.true_angles_rad[1:],
            sigma_m=exactly * instrument.sigma_m,
            sigma_rad=exactly * instrument.sigma_rad,
            full_pose=instrument.full_pose,
            rng=self._rng(_Stream.TRACKER),
        )

    def _rng(self, stream: _Stream) -> np.random.Generator:
        measures = stream in (_Stream.NOISE, _Stream.TRACKER)
        seed = self.seed if measures or self.specimen is None else self.specimen
        again = [self.placement] if measures and self.placement > 1 else []
        return np.random.default_rng([seed, int(stream), *again])


def scenario(name: str, seed: int = 0) -> Scenario:
    """Return a scenario by name.

    Raises
    ------
    ValueError
        If there is no such scenario or the seed is negative.
    """
    if seed < 0:
        raise ValueError("a seed is a whole number from zero")
    match name:
        case "exact":
            return Scenario(
                name=name, seed=seed, truth=paper_loop(), encoders_only=True, noise=False
            )
        case "datasheet":
            return Scenario(name=name, seed=seed, truth=paper_loop(), curve_of_full_scale=0.02)
        case "as_reported":
            return Scenario(
                name=name,
                seed=seed,
                truth=paper_loop(),
                specimen=8,
                curve_of_full_scale=0.019,
                lengths=LengthErrors(smallest_m=0.001, largest_m=0.002),
                loads=YIELDING,
            )
        case "wild":
            truth = wild_loop(
                np.random.default_rng([seed, int(_Stream.WILD)]),
                spread=WildSpread(),
                reading_rad=PAPER_HOME_RAD,
            )
            return Scenario(name=name, seed=seed, truth=truth, curve_of_full_scale=0.02)
        case _:
            raise ValueError(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")


def scenario_of(name: str, seed: int, stated: Stated, placement: int = 1) -> Scenario:
    """Return a scenario for an arm and a fixture: the paper's own where the files may mean it.

    From its second `placement` on the fixture is somewhere else, drawn by seed within its file's tolerance; the
    arm is the same.

    Of all others the truth is drawn by seed within what the files state; lengths and twists that
    nothing identifies are off as well, but in ``exact``. What scenarios have beside their truth
    (sensors, curves, loads, length errors) they have for every arm.

    Raises
    ------
    ValueError
        There is no such scenario, or no plant can be built of these files; says why.
    """
    found = _first_mounted(name, seed, stated)
    if placement == 1:
        return found
    rng = np.random.default_rng([seed, int(_Stream.MOUNTING), placement])
    truth = mounted_anew(stated, found.truth, rng)
    return replace(found, truth=truth, placement=placement)


def _first_mounted(name: str, seed: int, stated: Stated) -> Scenario:
    of_paper = scenario(name, seed)
    rng = np.random.default_rng([seed, int(_Stream.SPECIMEN)])
    if may_be(stated, paper_loop(), PAPER_HOME_RAD):
        if stated.fixture.holds_hand:
            return of_paper
        # The same arm as in the hinge, taken out of it.
        return replace(of_paper, truth=opened(stated, of_paper.truth, rng))
    truth = drawn_truth(
        stated,
        rng,
        maker_errors=name != "exact" and of_paper.lengths is None,
    )
    return replace(of_paper, truth=truth, specimen=None, loads=of_paper.loads.of(stated.arm))
