"""Registration of an instrument and its target: finds from the measured poses the placements that no file states."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from operator_app.calibration.calibrated_arm import with_entries
from operator_app.calibration.experiment import EndpointMissingError, Experiment
from operator_app.calibration.result import Solution
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import is_entry
from solver.chain.poses import PoseSet
from solver.chain.rotations import nearest_rotation, rotation_matrix, rotation_vector, skew
from solver.diagnostics.limits import FAR_FROM_NOMINAL_M, FAR_FROM_NOMINAL_RAD
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel, poses_needed
from solver.loops.endpoints import MeasuredClosure
from solver.loops.placements import Placements

REGISTRATION_STEPS, LARGEST_STEP_RAD, NO_STEP = 25, 0.5, 1e-6
"""Limits of the Gauss-Newton iteration for the placements of base and target: largest number of steps, largest rotation
in a step (rad), and step (rad, m) below which the iteration has converged."""

POINT_ERROR_M, PRIOR_SIGMAS = 1e-3, 3.0
"""Error of a point computed with the arm file's entries, and number of standard deviations in a tolerance. Both give
the weight of the target's stated position, which is needed if the tool has the same orientation in all poses."""

DIGITS = 4
"""Number of decimal places (m, rad) of a registered placement, which is only a start value of the calibration."""


def with_registered_instrument(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet
) -> EndpointConstraint:
    """Return the fixture with the instrument's placements, estimated from the poses if no file states them."""
    if not isinstance(fixture, Measured) or poses.endpoint is None:
        return fixture
    fixture = replace(fixture, full_pose=fixture.full_pose and poses.endpoint.shape[1] == 6)
    stated = fixture.tolerance
    if stated.position_m <= FAR_FROM_NOMINAL_M and stated.orientation_rad <= FAR_FROM_NOMINAL_RAD:
        return fixture
    # An instrument that was moved has a base of its own in each placement: that with the most poses is used.
    numbers, counts = np.unique(poses.placement, return_counts=True)
    station = poses.at_poses(poses.placement == numbers[np.argmax(counts)])
    return _refined(arm, placed_by_poses(arm, fixture, station, {}), station)


def _refined(arm: ArmModel, fixture: Measured, poses: PoseSet) -> EndpointConstraint:
    """Return the fixture with base and target fitted together with the arm's offsets; unchanged if the fit fails."""
    model = Experiment(arm=arm, fixture=fixture, poses=poses).loop()
    if len(poses) < poses_needed(len(model.parameters), model.equations_per_pose):
        return fixture
    estimate = estimate_paper(model, poses.q_rad)
    if not estimate.converged or not isinstance(model, MeasuredClosure):
        return fixture
    own = model.own_values(estimate.x)[0]
    if np.abs(own[6:9] - fixture.tip_m).max() > fixture.tolerance.position_m:
        # These poses do not determine the target's place.
        return fixture
    return with_calibrated_places(
        fixture,
        replace(
            model,
            base_m=own[:3].round(DIGITS),
            base_rotation=rotation_matrix(own[3:6]) @ model.base_rotation,
            tip_m=own[6:9].round(DIGITS),
            tip_rotation=rotation_matrix(own[9:]) @ model.tip_rotation,
        ),
    )


def with_calibrated_places(fixture: EndpointConstraint, model: ClosureModel) -> EndpointConstraint:
    """Return an instrument with its base and target placed as in `model`; any other fixture is returned unchanged."""
    part = model.parts()[0][0]
    if not isinstance(fixture, Measured) or not isinstance(part, MeasuredClosure):
        return fixture
    return replace(
        fixture,
        full_pose=part.full_pose,
        base_m=triple(part.base_m),
        base_turn_rad=triple(rotation_vector(part.base_rotation)),
        tip_m=triple(part.tip_m),
        tip_turn_rad=triple(rotation_vector(part.tip_rotation)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentStation:
    """Calibrated T_instrument_base and T_flange_target, (4, 4), m, of one placement.

    `placement`: number of the placement; None if there is only one.
    `full_pose`: whether orientations were measured; if not, the target's rotation is the nominal one.
    """

    placement: int | None
    T_instrument_base: FloatArray
    T_flange_target: FloatArray
    full_pose: bool


def instrument_stations(solution: Solution) -> tuple[InstrumentStation, ...]:
    """Return the calibrated stations of an instrument; empty with other fixtures."""
    model, x, stations = solution.model, solution.estimate.x, list[InstrumentStation]()
    numbers = model.numbers if isinstance(model, Placements) else (None,)
    for number, (part, columns, _) in zip(numbers, model.parts(), strict=True):
        if isinstance(part, MeasuredClosure):
            T_instrument_base, T_flange_target = part.placements(x[columns])
            stations.append(
                InstrumentStation(
                    placement=number,
                    T_instrument_base=T_instrument_base,
                    T_flange_target=T_flange_target,
                    full_pose=part.full_pose,
                )
            )
    return tuple(stations)


def endpoints_at_nominal_base(
    arm: ArmModel,
    fixture: Measured,
    poses: PoseSet,
    solution: Solution,
    placements: Collection[int],
) -> PoseSet:
    """Return the poses with the endpoints of `placements` converted, as if measured from the nominal station.

    For this, the pose of the arm's base in each placement is fitted with the calibrated arm and target. A later fit to
    the returned endpoints can start from the nominal pose of the base, however far the instrument was moved.
    """
    part, columns, _ = solution.model.parts()[0]
    if poses.endpoint is None or not isinstance(part, MeasuredClosure):
        return poses
    x = solution.estimate.x[columns]
    values = {p.name: float(v) for p, v in zip(part.parameters, x, strict=True) if is_entry(p.name)}
    _, T_flange_target = part.placements(x)
    calibrated = replace(
        fixture,
        tip_m=triple(T_flange_target[:3, 3]),
        tip_turn_rad=triple(rotation_vector(T_flange_target[:3, :3])),
        tip_known=True,
    )
    nominal = rotation_matrix(np.array(fixture.base_turn_rad))
    endpoint = poses.endpoint.copy()
    for number in placements:
        rows = poses.placement == number
        placed = placed_by_poses(arm, calibrated, poses.at_poses(rows), values)
        moved = nominal @ rotation_matrix(np.array(placed.base_turn_rad)).T
        endpoint[rows, :3] = (endpoint[rows, :3] - placed.base_m) @ moved.T + fixture.base_m
        if endpoint.shape[1] == 6:
            turned = moved @ rotation_matrix(endpoint[rows, 3:])
            endpoint[rows, 3:] = rotation_vector(turned)
    return replace(poses, endpoint=endpoint)


def placed_by_poses(
    arm: ArmModel, instrument: Measured, poses: PoseSet, values: Mapping[str, float]
) -> Measured:
    """Return the instrument with the unknown placements of base and target estimated from the measured poses.

    `values`: entries (rad, m), by name, that replace the arm file's. Raises `EndpointMissingError` without endpoints.
    """
    if poses.endpoint is None:
        raise EndpointMissingError
    full = poses.endpoint.shape[1] == 6
    measured = poses.endpoint[:, :3]
    frames = with_entries(arm.table, values).frames(poses.q_rad)
    R_base, base, tip = _fitted(frames.p_end, frames.R_end, measured, instrument)
    turn = np.array(instrument.tip_turn_rad)
    if full and not instrument.tip_known:
        R_seen = rotation_matrix(poses.endpoint[:, 3:])
        mean = np.einsum("mji,kj,mkl->il", frames.R_end, R_base, R_seen)
        turn = rotation_vector(nearest_rotation(mean))
    return replace(
        instrument,
        full_pose=full and instrument.full_pose,
        base_m=triple(base),
        base_turn_rad=triple(rotation_vector(R_base)),
        tip_m=triple(tip),
        tip_turn_rad=triple(turn),
    )


def _fitted(
    p: FloatArray, R: FloatArray, measured: FloatArray, instrument: Measured
) -> tuple[FloatArray, ...]:
    """Fit ``base + R_base (p + R tip)`` to `measured` points (m, 3), m; return R_base (3, 3), base (3,) and tip (3,).

    R_base and base locate the arm's base in the instrument's frame; tip is the target's position in the flange's frame.
    `p` (m, 3) and `R` (m, 3, 3) locate the flange in the base frame. If R_base is unknown, Gauss-Newton starts from all
    24 rotations of a cube. A weak prior keeps tip near nominal.
    """
    from scipy.spatial.transform import Rotation

    stated = np.array(instrument.tip_m)
    prior = POINT_ERROR_M * PRIOR_SIGMAS / instrument.tolerance.position_m
    known = rotation_matrix(np.array(instrument.base_turn_rad))
    turns = known[None] if instrument.base_known else Rotation.create_group("O").as_matrix()
    free = np.repeat(
        [not instrument.base_known, not instrument.base_known, not instrument.tip_known], 3
    )
    fits = []
    for start in turns:
        R_base = start
        base, tip = np.array(instrument.base_m), np.array(instrument.tip_m)
        for step in range(REGISTRATION_STEPS):
            swung = (p + R @ tip) @ R_base.T
            J = np.zeros((*swung.shape, 9))
            J[..., 0:3] = -skew(swung)
            J[..., 3:6] = np.eye(3)
            J[..., 6:9] = R_base @ R
            # The first step finds the placements for this rotation.
            used = free & (np.arange(9) >= 3) if step == 0 else free
            residual = measured - base - swung
            d = np.zeros(9)
            # A turn that the points hardly determine, e.g. about a line on which all of them are, stays small.
            damping = POINT_ERROR_M * np.eye(9)[:3]
            A = np.concatenate((J.reshape(-1, 9), prior * np.eye(9)[6:], damping))
            b = np.concatenate((residual.reshape(-1), prior * (stated - tip), np.zeros(3)))
            d[used] = np.linalg.lstsq(A[:, used], b)[0]
            turn = d[:3] * min(1.0, LARGEST_STEP_RAD / max(float(np.linalg.norm(d[:3])), 1e-12))
            R_base = rotation_matrix(turn) @ R_base
            base, tip = base + d[3:6], tip + d[6:]
            if step > 0 and np.abs(d).max() < NO_STEP:
                break
        residual = measured - base - (p + R @ tip) @ R_base.T
        fits.append((float((residual**2).sum()), (R_base, base, tip)))
    return min(fits, key=lambda places: places[0])[1]


def triple(v: FloatArray) -> tuple[float, float, float]:
    """Return a vector (3,) as three floats."""
    return float(v[0]), float(v[1]), float(v[2])
