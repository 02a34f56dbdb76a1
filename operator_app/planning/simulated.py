"""Simulates poses of an arm in a fixture: random true values, closed loops, sensor errors from the arm file.

Errors: lengths and twists within tolerance, sensor resolution and noise, linearity deviation of RVDTs. Not included:
encoder scales, backlash, sag and fixture compliance, which the virtual controller simulates.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hardware.virtual.axis import JointSensor, LinearityDeviation, joint_sensor
from operator_app.calibration.error_model import free_within_tolerance
from operator_app.config.fixture_file import FixtureSpec
from operator_app.errors import SessionError
from operator_app.planning.task import margin_rad, ranges_of, require_closed_chain
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import Parameter, nominal_vector
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor, Rvdt
from solver.design.manifold import Manifold, candidate_poses
from solver.loops.closure import ClosureModel

PLANTED_OFFSET_RAD = float(np.deg2rad(2.0))
"""Standard deviation of the joint offsets if the arm file has no tolerance for them."""
OF_TOLERANCE = 0.5
"""Largest error of the placement, as a share of the fixture's tolerance."""
SIMULATION_TRIES = 40
ROOM = 4
"""Number of closed poses generated per requested pose; the requested poses are drawn from them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedPoses:
    """Simulated readings, and the true parameter values.

    `parameters`: unknowns, including the lengths and twists that may vary within their tolerances.
    `x` (P,): true values of the unknowns, rad and m.
    """

    poses: PoseSet
    parameters: tuple[Parameter, ...]
    x: FloatArray


def simulated_poses(
    arm: ArmModel, fixture: FixtureSpec, *, poses: int, samples: int = 32, seed: int = 0
) -> SimulatedPoses:
    """Draw an arm and a placement at random (`seed`), and simulate readings at `poses` closed poses.

    Raises `SessionError` if the fixture leaves the chain open, or no drawn placement allows that many poses.
    """
    require_closed_chain(fixture.fixture)
    rng = np.random.default_rng([seed, 7])
    model, spread = free_within_tolerance(fixture.fixture.model(arm), arm)
    x, manifold = _moving(arm, fixture, model, spread, rng, poses)
    chosen = np.sort(rng.choice(manifold.size, size=poses, replace=False))
    sensors = [_sensor(arm, j, rng) for j in range(arm.joint_count)]
    draws = rng.standard_normal((poses, samples, arm.joint_count))
    readings = np.zeros((poses, arm.joint_count, samples))
    for j, sensor in enumerate(sensors):
        if sensor is not None:
            for k, angle in enumerate(manifold.q[chosen, j].tolist()):
                counts = [sensor.counts(angle, z) for z in draws[k, :, j].tolist()]
                readings[k, j] = np.array(counts) * sensor.resolution_rad
    return SimulatedPoses(
        poses=PoseSet(
            placement=np.ones(poses, dtype=np.int64),
            label=tuple(str(k) for k in range(1, poses + 1)),
            q_rad=readings.mean(-1),
            sd_rad=readings.std(-1, ddof=1) if samples > 1 else None,
            samples=np.full(poses, samples, dtype=np.int64),
        ),
        parameters=model.parameters,
        x=x,
    )


def _moving(
    arm: ArmModel,
    fixture: FixtureSpec,
    model: ClosureModel,
    spread: Mapping[str, float],
    rng: np.random.Generator,
    poses: int,
) -> tuple[FloatArray, Manifold]:
    """Draw true values until at least `poses` poses close; return the values (P,), rad and m, and the closed poses."""
    ranges, nominal = ranges_of(arm).within(margin_rad(arm)), nominal_vector(model.parameters)
    offset_rad = arm.offset_tolerance_rad or PLANTED_OFFSET_RAD
    mounted, tolerance = {*model.ground_side, *model.hand_side}, fixture.fixture.tolerance

    def error(p: Parameter) -> float:
        if p.name in spread:
            return spread[p.name] * rng.standard_normal()
        if p.name in mounted and not p.name.startswith("theta_off"):
            most = tolerance.orientation_rad if p.is_angle else tolerance.position_m
            return OF_TOLERANCE * most * rng.uniform(-1.0, 1.0)
        return (offset_rad if p.is_angle else 0.0) * rng.standard_normal()

    for _ in range(SIMULATION_TRIES):
        x = np.asarray(nominal + np.array([error(p) for p in model.parameters]))
        try:
            manifold = candidate_poses(model, x, arm.home_rad, ranges, count=ROOM * poses)
        except ValueError:
            continue
        if manifold.size >= poses:
            return x, manifold
    raise SessionError(
        f"the loop of {arm.name} in fixture {fixture.name} does not close near home for "
        f"{poses} poses in any of {SIMULATION_TRIES} drawn placements",
        "check the fixture's placement and the arm's home pose (sarcal plan), or request fewer poses",
    )


def _sensor(arm: ArmModel, joint: int, rng: np.random.Generator) -> JointSensor | None:
    """Return the simulated sensor of a joint (0-based), or None; RVDTs deviate at random, with the specified peak."""
    stated, curve = arm.joints[joint], None
    sensor = stated.sensor
    if isinstance(sensor, NoSensor):
        return None
    if isinstance(sensor, Rvdt) and sensor.linearity > 0.0:
        curve = LinearityDeviation.drawn(
            rng, full_scale_rad=sensor.full_scale_rad, peak=sensor.linearity
        )
    return joint_sensor(stated, with_noise=True, curve=curve)
