"""True geometry of any arm in any fixture, drawn by seed within the tolerances of the arm and fixture files.

Offsets are drawn within `SPECIMEN_OFFSET_RAD`; the fixture's placement within the tolerance of its file (three sigma);
the maker's lengths and twists with the standard deviations of the arm file. Unknowns of the calibration that poses
cannot determine keep their nominal values.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.setup_checks import mobility, mounted_entries
from hardware.virtual.true_loop import Truth
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.chain.rotations import rotation_matrix
from solver.loops.arm_loop import ArmLoop
from solver.loops.dh import DhLoop
from solver.loops.endpoints import MeasuredClosure, PointClosure

SPECIMEN_OFFSET_RAD = float(np.deg2rad(3.0))
"""Largest difference of true offsets from those of the arm file."""
OFFSET_TOLERANCE_RAD = float(np.deg2rad(10.0))
"""An arm file describes an arm only if no true offset differs from the file's by more than this."""
NEAR_HOME_RAD = float(np.deg2rad(15.0))
"""Largest difference of a specimen's start pose from the start pose of the nominal geometry."""
RANGE_MARGIN_RAD = float(np.deg2rad(3.0))
"""Smallest distance of the start pose from the ends of the ranges."""
MAX_DRAWS = 200


def draw_truth(
    arm: ArmModel, fixture: EndpointConstraint, rng: np.random.Generator, *, maker_errors: bool
) -> Truth:
    """Draw true values with which the loop closes near the arm's home; raises `ValueError` if there are none.

    `maker_errors`: whether lengths and twists that the calibration does not identify have errors too.
    """
    kind, model = fixture.kind, fixture.model(arm)
    if not isinstance(model, DhLoop | PointClosure | MeasuredClosure):
        raise ValueError(f"a {kind} fixture cannot be simulated")  # noqa: TRY004
    nominal = nominal_vector(model.parameters)
    home_pose = _pose(_truth(model, nominal, model.arm_rows()), arm, arm.home_rad)
    if home_pose is None:
        raise ValueError(
            f"no pose near the arm's home_deg and inside its ranges closes the loop of this {kind} fixture"
        )
    (free, maker), rows = _arm_differences(arm, rng), model.arm_rows()
    if maker_errors:
        rows[1:] += maker
    of_fixture, errors = {*model.ground_side, *model.hand_side}, np.zeros(len(nominal))
    for k, entry in enumerate(model.entries):
        if entry.kind is DhKind.THETA_OFF or entry.name not in of_fixture:
            errors[k] = free[entry.kind, entry.row - 1]
    observable = _observable(arm, fixture, model, nominal, home_pose)
    placed = (
        nominal + observable * (errors + _placement_errors(model, fixture, rng))
        for _ in range(MAX_DRAWS)
    )
    return _first_that_closes(
        (_truth(model, x, rows) for x in placed),
        arm,
        home_pose,
        f"this arm closes near its home_deg in none of {MAX_DRAWS} placements drawn within the fixture's tolerance: "
        "state a smaller tolerance or another home; or draw another arm with --seed",
    )


def _first_that_closes(
    drawn: Iterable[Truth], arm: ArmModel, home_pose: FloatArray, otherwise: str
) -> Truth:
    for truth in drawn:
        pose = _pose(truth, arm, arm.home_rad)
        if pose is not None and np.abs(pose - home_pose).max() < NEAR_HOME_RAD:
            return truth
    raise ValueError(otherwise)


def _arm_differences(arm: ArmModel, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw differences between an arm and its file, rad and m: array (5, n) for calibrated entries, (4, n) for others.

    Rows: theta_off (first array only), s, a, alpha, beta. Both arrays are drawn in full, although only one value of
    each entry is used, so that a seed gives the same arm whichever entries are calibrated.
    """
    n, hayati = arm.joint_count, [row - 1 for row in arm.hayati_rows]
    stated = np.array([arm.length_tolerance_m, arm.length_tolerance_m, arm.twist_tolerance_rad])
    free, maker = np.zeros((5, n)), np.zeros((4, n))
    free[DhKind.THETA_OFF] = SPECIMEN_OFFSET_RAD * rng.uniform(-1.0, 1.0, n)
    free[1:4] = 3.0 * stated * _clipped_normal(rng, (3, n))
    maker[:3] = stated * rng.standard_normal((3, n))
    # For parallel axes (Hayati) a twist about y replaces the offset along z.
    twist = arm.twist_tolerance_rad[hayati]
    free[DhKind.BETA, hayati] = 3.0 * twist * _clipped_normal(rng, twist.shape)
    maker[-1, hayati] = twist * rng.standard_normal(len(hayati))
    maker[0, hayati] = 0.0
    return free, maker


def _observable(
    arm: ArmModel, fixture: EndpointConstraint, model: ArmLoop, x: FloatArray, q: FloatArray
) -> FloatArray:
    """Return 1 for each observable unknown of `model`, otherwise 0, shape (P,)."""
    still: set[str] = set()
    if fixture.holds_hand:
        still = {f"theta_off_{j}" for j in mobility(model, x, q).immobile_joints}
    hidden = {check.entry for check in fixture.placement_checks(arm, model, x)}
    return np.array([0.0 if p.name in still | hidden else 1.0 for p in model.parameters])


def files_allow(
    arm: ArmModel, fixture: EndpointConstraint, truth: Truth, home_rad: FloatArray
) -> bool:
    """Whether arm and fixture files allow the true arm and hinge `truth`, closed at the readings `home_rad` (n,).

    Calibrated entries may differ from the files by the fixture's tolerance (offsets by `OFFSET_TOLERANCE_RAD`), other
    entries by five standard deviations. An instrument (open arm) allows any hinge and any mounting. The
    file of a hinge requires `home_rad` within 2 `NEAR_HOME_RAD` of the arm file's home. Other fixtures allow no truth.
    """
    model = fixture.model(arm)
    if model.joint_count != truth.loop.joint_count:
        return False
    # Last axis: D-H rows 0 (the fixture) to n.
    allowed = np.zeros(truth.table.stacked().shape)
    allowed[[DhKind.S, DhKind.A], 1:] = 5.0 * arm.length_tolerance_m
    allowed[[DhKind.ALPHA, DhKind.BETA], 1:] = 5.0 * arm.twist_tolerance_rad
    if isinstance(model, MeasuredClosure):
        difference = -truth.table.stacked()
        difference[:, 1:] += arm.table.stacked()
        allowed[DhKind.THETA_OFF] = OFFSET_TOLERANCE_RAD
        allowed[:, 0] = np.inf
        for name in mounted_entries(arm.joint_count):
            entry = DhEntry.parse(name)
            allowed[entry.kind, entry.row] = np.inf
    elif isinstance(model, DhLoop) and model.hinge:
        if np.abs(arm.home_rad - home_rad).max() >= 2.0 * NEAR_HOME_RAD:
            return False
        difference = model.table.stacked() - truth.table.stacked()
        for entry in model.entries:
            limits = fixture.tolerance
            angle = limits.orientation_rad if entry.kind.is_angle else limits.position_m
            is_offset = entry.kind is DhKind.THETA_OFF
            allowed[entry.kind, entry.row] = OFFSET_TOLERANCE_RAD if is_offset else angle
    else:
        return False
    angles = [kind for kind in DhKind if kind.is_angle]
    difference[angles] = np.remainder(difference[angles] + np.pi, 2.0 * np.pi) - np.pi
    return bool(np.all(np.abs(difference) <= allowed + 1e-9))


def open_truth(
    arm: ArmModel, fixture: EndpointConstraint, truth: Truth, rng: np.random.Generator
) -> Truth:
    """Return the truth of the same arm without its fixture, but with a target on its tool for an instrument.

    The arm's base and the target are placed at random within tolerance. D-H entries that cannot be separated from these
    two placements have their nominal values. `ValueError` if `fixture` is no instrument.
    """
    model = fixture.model(arm)
    if not isinstance(model, MeasuredClosure):
        raise ValueError(f"a {fixture.kind} fixture constrains the tool")  # noqa: TRY004
    rows, nominal = truth.table.stacked()[:, 1:].copy(), arm.table.stacked()
    for name in mounted_entries(arm.joint_count):
        entry = DhEntry.parse(name)
        rows[entry.kind, entry.row - 1] = nominal[entry.kind, entry.row - 1]
    target_model = model.without([entry.name for entry in model.entries])
    placed = nominal_vector(target_model.parameters)
    return _truth(target_model, placed + _placement_errors(target_model, fixture, rng), rows)


def remount_truth(
    arm: ArmModel, fixture: EndpointConstraint, truth: Truth, rng: np.random.Generator
) -> Truth:
    """Return the truth of the same arm and fixture, mounted again within the tolerance of the fixture file.

    The placement of the fixture on the table changes. The placement on the tool changes too, unless the fixture stays
    on the tool. An offset that is measured from a changed placement (theta_off_1, theta_off_n) also changes. Raises
    `ValueError` if no placement drawn lets the arm close near home.
    """
    model = fixture.model(arm)
    if not isinstance(model, DhLoop | PointClosure):
        raise ValueError(f"a {fixture.kind} fixture is not remounted")  # noqa: TRY004
    sides = {*model.ground_side, *(() if fixture.stays_on_hand else model.hand_side)}
    rows = truth.table.stacked()[:, -arm.joint_count :]
    named, nominal = truth.named(), nominal_vector(model.parameters)
    true = np.array([named[p.name] for p in model.parameters])
    size = _tolerances(model, fixture)
    offset = np.array([p.name.startswith("theta_off_") for p in model.parameters])
    centre = np.where(offset, true, nominal)
    home_pose = _pose(truth, arm, arm.home_rad)
    if home_pose is None:
        raise ValueError("in its first placement, this arm does not close near its home_deg")
    observable = _observable(arm, fixture, model, nominal, home_pose) > 0.0
    new = observable & np.array([p.name in sides for p in model.parameters])
    drawn = (centre + size * _clipped_normal(rng, (len(size),)) for _ in range(MAX_DRAWS))
    return _first_that_closes(
        (_truth(model, np.where(new, x, true), rows) for x in drawn),
        arm,
        home_pose,
        f"this arm closes near its home_deg in none of {MAX_DRAWS} remountings drawn within the fixture file's "
        "tolerance: state a smaller tolerance",
    )


def _tolerances(model: ArmLoop, fixture: EndpointConstraint) -> FloatArray:
    limits = fixture.tolerance
    angles = [p.is_angle for p in model.parameters]
    return np.where(angles, limits.orientation_rad, limits.position_m)


def _placement_errors(
    model: ArmLoop, fixture: EndpointConstraint, rng: np.random.Generator
) -> FloatArray:
    """Draw the errors (P,) of a loop's unknowns that belong to the fixture; 0 for unknowns of the arm."""
    offsets = {entry.name for entry in model.entries if entry.kind is DhKind.THETA_OFF}
    placed = {*model.ground_side, *model.hand_side} - offsets
    size = _tolerances(model, fixture) * [p.name in placed for p in model.parameters]
    return size * _clipped_normal(rng, size.shape)


def _clipped_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Draw fractions of a tolerance: normal with standard deviation 1/3, clipped to -1..1."""
    return np.clip(rng.standard_normal(shape) / 3.0, -1.0, 1.0)


def _truth(
    model: DhLoop | PointClosure | MeasuredClosure, x: FloatArray, rows: FloatArray
) -> Truth:
    """Return the true geometry: `x` (P,) are the P unknowns of `model`, `rows` (5, n) the arm's other D-H entries."""
    stacked = model.table.stacked()
    stacked[:, -rows.shape[1] :] = rows
    with_rows = replace(model, table=DhTable.from_stacked(stacked))
    table = DhTable.from_stacked(with_rows.tables(x))
    if isinstance(model, DhLoop):
        return Truth(DhLoop(table=table, entries=(), hinge=model.hinge))
    own = model.own_values(x)[0]
    if isinstance(model, PointClosure):
        return Truth(PointClosure(table=table, entries=(), own=(), tip_m=own[:3], ground_m=own[3:]))
    return Truth(
        MeasuredClosure(
            table=table,
            entries=(),
            base_m=own[:3],
            base_rotation=rotation_matrix(own[3:6]) @ model.base_rotation,
            tip_m=own[6:9],
            tip_rotation=rotation_matrix(own[9:]) @ model.tip_rotation,
            full_pose=True,
        )
    )


def _pose(truth: Truth, arm: ArmModel, near_rad: FloatArray) -> FloatArray | None:
    """Return the readings (n,) of the closed pose nearest to `near_rad`; None if there is none inside the ranges."""
    try:
        pose = truth.closed_near(near_rad)
    except ValueError:
        return None
    reading, margin = pose[1:] - truth.offsets_rad, RANGE_MARGIN_RAD
    inside = (reading > arm.lower_rad + margin) & (reading < arm.upper_rad - margin)
    return reading if np.all(inside) else None
