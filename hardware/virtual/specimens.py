"""A specimen of any arm in any fixture: a truth drawn by seed within what their files state. Knows no bus.

What calibration identifies is drawn: offsets within `OFFSET_RAD`, the fixture within the tolerance of
its file (a third of it is one standard deviation). What is taken from the maker's table is off by the
tolerance that the arm file states. What is not free, or what the loop could not show (the offset of a
joint that does not move), is what the file says it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fixtures.base import Fixture
from fixtures.setup_checks import mobility
from hardware.virtual.truth import BallTruth, LoopTruth, OpenTruth, Truth
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.chain.rotations import rotation_matrix
from solver.loops.arm_loop import ArmLoop
from solver.loops.dh import DhLoop
from solver.loops.open_arm import MeasuredClosure
from solver.loops.point import PointClosure

OFFSET_RAD = float(np.deg2rad(3.0))
"""How far true offsets lie from the arm file's, at most: no file states it."""
MISREMEMBERED_RAD = float(np.deg2rad(10.0))
"""How far the offsets of a file may be from those of an arm that it still may mean."""
NEAR_HOME_RAD = float(np.deg2rad(15.0))
"""How far any joint of the pose that a specimen starts from may be from that of the files as stated."""
INSIDE_RAD = float(np.deg2rad(3.0))
"""What that pose keeps from the ends of the ranges."""
TRIES = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """What the files say of a specimen.

    `tolerance_m` and `tolerance_rad` are the fixture file's: the true placement is within them.
    """

    arm: ArmModel
    fixture: Fixture
    tolerance_m: float
    tolerance_rad: float


def drawn_truth(stated: Stated, rng: np.random.Generator, *, maker_errors: bool) -> Truth:
    """Draw a truth that closes near the arm's home.

    Parameters
    ----------
    maker_errors
        Whether lengths and twists that nothing identifies are off by their tolerance, too.

    Raises
    ------
    ValueError
        No plant can be built of these files; says why.
    """
    arm, kind = stated.arm, stated.fixture.kind
    model = stated.fixture.model(arm)
    if not isinstance(model, DhLoop | PointClosure | MeasuredClosure):
        raise ValueError(f"no virtual arm knows how a {kind} fixture holds its hand")  # noqa: TRY004
    nominal = nominal_vector(model.parameters)
    here = _pose(_truth(model, nominal, model.arm_rows()), arm, arm.home_rad)
    if here is None:
        raise ValueError(
            f"as stated, no pose near the arm's home_deg and inside its ranges closes the loop of its {kind}"
        )
    own, rows = _Specimen.drawn(arm, rng), model.arm_rows()
    if maker_errors:
        rows[1:] += own.maker
    off, seen = own.of(model), _seen(stated, model, nominal, here)
    placed = (nominal + seen * (off + _placed(model, stated, rng)) for _ in range(TRIES))
    return _first_that_closes(
        (_truth(model, x, rows) for x in placed),
        arm,
        here,
        f"in none of {TRIES} placements drawn within the tolerance of its file does this arm close near its "
        "home_deg: state the placement more narrowly, or another home; another --seed is another arm",
    )


def _first_that_closes(
    drawn: Iterable[Truth], arm: ArmModel, here: FloatArray, otherwise: str
) -> Truth:
    """Return the first of some placements in which the arm closes near `here` (n,); ValueError if in none."""
    for truth in drawn:
        pose = _pose(truth, arm, arm.home_rad)
        if pose is not None and np.abs(pose - here).max() < NEAR_HOME_RAD:
            return truth
    raise ValueError(otherwise)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Specimen:
    """How far one arm is from its file, whatever holds or sees its hand.

    Attributes
    ----------
    free
        (5, n): what may be identified.
    maker
        (4, n): s (m), a (m), alpha, beta (rad) where nothing identifies them.
    """

    free: FloatArray
    maker: FloatArray

    @classmethod
    def drawn(cls, arm: ArmModel, rng: np.random.Generator) -> _Specimen:
        """Draw all of it, needed or not, and before anything else of `rng`: for one seed it is one arm."""
        n, hayati = arm.joint_count, [row - 1 for row in arm.hayati_rows]
        stated = np.array([arm.length_tolerance_m, arm.length_tolerance_m, arm.twist_tolerance_rad])
        free, maker = np.zeros((5, n)), np.zeros((4, n))
        free[DhKind.THETA_OFF] = OFFSET_RAD * rng.uniform(-1.0, 1.0, n)
        free[1:4] = 3.0 * stated * _thirds(rng, (3, n))
        maker[:3] = stated * rng.standard_normal((3, n))
        # Where axes are parallel, a twist about y takes the place of a slide along z.
        twist = arm.twist_tolerance_rad[hayati]
        free[DhKind.BETA, hayati] = 3.0 * twist * _thirds(rng, twist.shape)
        maker[-1, hayati] = twist * rng.standard_normal(len(hayati))
        maker[0, hayati] = 0.0
        return cls(free=free, maker=maker)

    def of(self, model: ArmLoop) -> FloatArray:
        """By how much the arm's unknowns of a loop are off (P,); 0 for those of the fixture."""
        placed = {*model.ground_side, *model.hand_side}
        off = np.zeros(len(model.parameters))
        for k, entry in enumerate(model.entries):
            if entry.kind is DhKind.THETA_OFF or entry.name not in placed:
                off[k] = self.free[entry.kind, entry.row - 1]
        return off


def _seen(stated: Stated, model: ArmLoop, x: FloatArray, q: FloatArray) -> FloatArray:
    """Which unknowns (P,) the loop can see, 1 or 0: the others stay as the files have them."""
    still: set[str] = set()
    if stated.fixture.holds_hand:
        still = {f"theta_off_{j}" for j in mobility(model, x, q).immobile_joints}
    hidden = {check.entry for check in stated.fixture.placement_checks(stated.arm, model, x)}
    return np.array([0.0 if p.name in still | hidden else 1.0 for p in model.parameters])


def may_be(stated: Stated, truth: LoopTruth, home_rad: FloatArray) -> bool:
    """Whether the files may mean this very arm in this very hinge, which closes at `home_rad` (n,).

    What they leave free may be off by its tolerance (offsets by `MISREMEMBERED_RAD`); all else is what
    the files say, within five of the standard deviations they state. Of an open arm the hinge, and with
    it what the mounting decides, does not count.
    """
    arm, model = stated.arm, stated.fixture.model(stated.arm)
    if model.joint_count != truth.joint_count:
        return False
    if isinstance(model, MeasuredClosure):
        return _may_be_arm(stated, truth)
    if not isinstance(model, DhLoop) or model.hinge != truth.hinge:
        return False
    off = model.table.stacked() - truth.table.stacked()
    angles = [kind for kind in DhKind if kind.is_angle]
    off[angles] = np.remainder(off[angles] + np.pi, 2.0 * np.pi) - np.pi
    allowed = np.zeros(off.shape)
    allowed[[DhKind.S, DhKind.A], 1:] = 5.0 * arm.length_tolerance_m
    allowed[[DhKind.ALPHA, DhKind.BETA], 1:] = 5.0 * arm.twist_tolerance_rad
    for entry in model.entries:
        angle = stated.tolerance_rad if entry.kind.is_angle else stated.tolerance_m
        is_offset = entry.kind is DhKind.THETA_OFF
        allowed[entry.kind, entry.row] = MISREMEMBERED_RAD if is_offset else angle
    near = np.abs(arm.home_rad - home_rad).max() < 2.0 * NEAR_HOME_RAD
    return bool(near and np.all(np.abs(off) <= allowed + 1e-9))


def _may_be_arm(stated: Stated, truth: LoopTruth) -> bool:
    """Whether the arm's file may mean the arm of this truth, whatever holds or sees its hand."""
    arm = stated.arm
    off = arm.table.stacked() - truth.table.stacked()[:, 1:]
    angles = [kind for kind in DhKind if kind.is_angle]
    off[angles] = np.remainder(off[angles] + np.pi, 2.0 * np.pi) - np.pi
    allowed = np.zeros(off.shape)
    allowed[DhKind.THETA_OFF] = MISREMEMBERED_RAD
    allowed[[DhKind.S, DhKind.A]] = 5.0 * arm.length_tolerance_m
    allowed[[DhKind.ALPHA, DhKind.BETA]] = 5.0 * arm.twist_tolerance_rad
    for name in mounted_entries(arm.joint_count):
        entry = DhEntry.parse(name)
        allowed[entry.kind, entry.row - 1] = np.inf
    return bool(np.all(np.abs(off) <= allowed + 1e-9))


def mounted_entries(joints: int) -> tuple[str, ...]:
    """Entries of the arm that cannot be told from where its base and its hand's side are."""
    last = (f"theta_off_{joints}", f"s_{joints}", f"a_{joints}", f"alpha_{joints}")
    return ("theta_off_1", "s_1", *last)


def opened(stated: Stated, truth: Truth, rng: np.random.Generator) -> OpenTruth:
    """The arm of another truth with nothing in its hand but a target; the instrument's place is drawn.

    What cannot be told from where base and target are is as the arm's file has it.
    """
    model = stated.fixture.model(stated.arm)
    if not isinstance(model, MeasuredClosure):
        raise ValueError(f"a {stated.fixture.kind} holds the hand")  # noqa: TRY004
    rows, nominal = truth.table.stacked()[:, 1:].copy(), stated.arm.table.stacked()
    for name in mounted_entries(stated.arm.joint_count):
        entry = DhEntry.parse(name)
        rows[entry.kind, entry.row - 1] = nominal[entry.kind, entry.row - 1]
    here = model.without([entry.name for entry in model.entries])
    found = _truth(here, nominal_vector(here.parameters) + _placed(here, stated, rng), rows)
    if not isinstance(found, OpenTruth):
        raise TypeError("the truth of an open arm is an open one")
    return found


def mounted_anew(stated: Stated, truth: Truth, rng: np.random.Generator) -> Truth:
    """The same arm in the same fixture, taken off and mounted anew within the tolerance of its file.

    Both its sides are new, but for that of the hand where it stays there; theta_off of the first and the
    last joint go with them, since they count from the fixture.

    Raises
    ------
    ValueError
        In no placement that was drawn does this arm close near its home.
    """
    arm, model = stated.arm, stated.fixture.model(stated.arm)
    if not isinstance(model, DhLoop | PointClosure):
        raise ValueError(f"a {stated.fixture.kind} fixture is not mounted anew")  # noqa: TRY004
    sides = {*model.ground_side, *(() if stated.fixture.stays_on_hand else model.hand_side)}
    rows = truth.table.stacked()[:, -arm.joint_count :]
    nominal, true = nominal_vector(model.parameters), _true_vector(model, truth)
    size = np.array(
        [stated.tolerance_rad if p.is_angle else stated.tolerance_m for p in model.parameters]
    )
    offset = np.array([p.name.startswith("theta_off_") for p in model.parameters])
    centre = np.where(offset, true, nominal)
    here = _pose(truth, arm, arm.home_rad)
    if here is None:
        raise ValueError("as first mounted, this arm does not close near its home_deg")
    seen = _seen(stated, model, nominal, here) > 0.0
    new = seen & np.array([p.name in sides for p in model.parameters])
    drawn = (centre + size * _thirds(rng, (len(size),)) for _ in range(TRIES))
    return _first_that_closes(
        (_truth(model, np.where(new, x, true), rows) for x in drawn),
        arm,
        here,
        f"mounted anew within the tolerance of its file, in none of {TRIES} placements does this arm close "
        "near its home_deg: state the placement more narrowly",
    )


def _true_vector(model: DhLoop | PointClosure, truth: Truth) -> FloatArray:
    """What the unknowns of a loop really are (P,)."""
    named = truth.named()
    return np.array([named[p.name] for p in model.parameters])


def _placed(model: ArmLoop, stated: Stated, rng: np.random.Generator) -> FloatArray:
    """By how much the fixture's unknowns of a loop are off (P,); 0 for those of the arm."""
    offsets = {entry.name for entry in model.entries if entry.kind is DhKind.THETA_OFF}
    placed = {*model.ground_side, *model.hand_side} - offsets
    size = [
        (stated.tolerance_rad if p.is_angle else stated.tolerance_m) * (p.name in placed)
        for p in model.parameters
    ]
    return np.array(size) * _thirds(rng, (len(size),))


def _thirds(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Draw shares of a tolerance of which a third is one standard deviation, none beyond it."""
    return np.clip(rng.standard_normal(shape) / 3.0, -1.0, 1.0)


def _truth(
    model: DhLoop | PointClosure | MeasuredClosure, x: FloatArray, rows: FloatArray
) -> Truth:
    """The truth with these unknowns (P,) and these arm rows (5, n) where nothing is unknown."""
    stacked = model.table.stacked()
    stacked[:, -rows.shape[1] :] = rows
    here = model.with_table(DhTable.from_stacked(stacked))
    found = here.tables(x)
    if isinstance(model, DhLoop):
        return LoopTruth(table=DhTable.from_stacked(found), hinge=model.hinge)
    table = DhTable.from_stacked(np.column_stack((np.zeros(len(found)), found)))
    own = model.own_values(x)[0]
    if isinstance(model, PointClosure):
        return BallTruth(table=table, tip_m=own[:3], ground_m=own[3:])
    return OpenTruth(
        table=table,
        base_m=own[:3],
        base_rotation=rotation_matrix(own[3:6]) @ model.base_rotation,
        tip_m=own[6:9],
        tip_rotation=rotation_matrix(own[9:]) @ model.tip_rotation,
    )


def _pose(truth: Truth, arm: ArmModel, near_rad: FloatArray) -> FloatArray | None:
    """Readings (n,) of the closed pose nearest to some angles; None if there is none inside the ranges."""
    try:
        pose, _ = truth.closed_near(near_rad)
    except ValueError:
        return None
    reading = pose - truth.offsets_rad
    inside = np.all(reading > arm.lower_rad + INSIDE_RAD) and np.all(
        reading < arm.upper_rad - INSIDE_RAD
    )
    return reading if inside else None
