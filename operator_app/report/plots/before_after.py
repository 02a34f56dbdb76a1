"""Pictures before and after calibration: arm and fixture in one pose, tool error over the workspace."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operator_app.calibration.calibrated_arm import calibrated_arm, hand_errors
from operator_app.calibration.tool_accuracy import Spread
from operator_app.messages.finding import fixed_briefly
from operator_app.report.plots.plot import Layer, Marks, Picture, Polyline, map_axes
from operator_app.report.subject import Subject
from operator_app.units import CLOSURE_LENGTH, LENGTH, Figure
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.estimators.estimate import closure_at_readings
from solver.loops.closure import ClosureModel

ASPECT = 1.25
AXIS_M = 0.08
"""Half the drawn length of a hinge's axis."""
ENLARGED = (1, 2, 5, 10, 20, 50, 100)
PANEL_GAP_SHARE = 0.15
"""Largest width of the drawn gap between tool and fixture, as a share of the arm's extent in the picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two pictures side by side, before and after, with the same axes, and a note on how to read them."""

    pictures: tuple[Picture, Picture]
    note: str


def hand_pair(subject: Subject) -> Pair | None:
    """Return pictures of the tool position error before and after calibration; None if it was not computed."""
    solution, arm = subject.solution, subject.procedure.arm
    if solution is None or (accuracy := solution.accuracy) is None:
        return None
    tip_m, before_m, after_m = hand_errors(calibrated_arm(solution, arm), arm)
    tip = LENGTH.per_si * tip_m
    out, along = np.hypot(tip[:, 0], tip[:, 1]).tolist(), tip[:, 2].tolist()
    labels = ("from joint 1's axis", "along joint 1's axis")
    x, y = map_axes(labels, out, along, unit=LENGTH.unit, aspect=ASPECT)
    largest = max(accuracy.before.worst, accuracy.after.worst)

    def shown(when: str, what: str, errors_m: FloatArray, spread: Spread) -> Picture:
        rms, worst = (Figure(v, CLOSURE_LENGTH).with_unit for v in (spread.rms, spread.worst))
        marks = Marks(
            x=out,
            y=along,
            sizes=(errors_m / largest).tolist(),
            label=f"pose, largest {worst}",
            tips=[Figure(e, CLOSURE_LENGTH).with_unit for e in errors_m.tolist()],
        )
        return Picture(
            ident=f"hand-{when.lower()}",
            title=f"{when}: {what} {rms} rms",
            description=f"{accuracy.poses} poses over the joints' ranges, each a mark whose area is the tool's "
            f"position error there: rms {rms}, largest {worst}.",
            x=x,
            y=y,
            layers=[marks],
            aspect=ASPECT,
        )

    return Pair(
        pictures=(
            shown("Before", "off by", before_m, accuracy.before),
            shown("After", "one sigma", after_m, accuracy.after),
        ),
        note="The area of a mark is the tool's position error there, on one scale in both pictures"
        f"{fixed_briefly(tuple(h.name for h in accuracy.holds_for))}.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """Arm and fixture in one pose: points, m, and directions of axes, all in the base frame.

    `chain`: points of the arm, the last one on the tool. `pin`: the point of the fixture where the tool should be.
    `hand_axis`, `pin_axis`: the fixture's axis on the tool and at `pin`; zero for a fixture without an axis.
    """

    chain: FloatArray
    hand_axis: FloatArray
    pin: FloatArray
    pin_axis: FloatArray

    @property
    def gap(self) -> FloatArray:
        """Vector, m, from the tool to the point where it should be."""
        return np.asarray(self.pin - self.chain[-1])


def arm_pair(subject: Subject) -> Pair | None:
    """Draw the arm before and after calibration, in the pose with the largest closure error at nominal parameters.

    Uses the first placement. Returns None without a calibration, if a joint is unsensed, or if the arm cannot be drawn.
    """
    solution = subject.solution
    if solution is None or solution.model.unsensed_joints:
        return None
    part, columns, poses = solution.model.parts()[0]
    q, numbers = subject.readings_rad[poses], np.array([p.number for p in subject.used])[poses]
    nominal = nominal_vector(solution.model.parameters)[columns]
    at_nominal = closure_at_readings(part, nominal, q)
    missed = np.linalg.norm(at_nominal.residual[:, at_nominal.rotation_rows :], axis=1)
    worst = int(np.argmax(missed))
    # With an instrument, the measured point differs from pose to pose.
    at_worst = part.at_poses(np.array([worst]))
    before = _seen(at_worst, nominal, q[worst])
    after = _seen(at_worst, solution.estimate.x[columns], q[worst])
    if before is None or after is None:
        return None
    view = _view(before.chain, -np.array(subject.procedure.arm.down))
    sizes = [float(np.linalg.norm(s.gap)) for s in (before, after)]
    reach = float(np.ptp(before.chain @ view.T, axis=0).max())
    times = max((k for k in ENLARGED if k * max(sizes) <= PANEL_GAP_SHARE * reach), default=1)
    kind = subject.procedure.fixture.kind
    if kind == "measured":
        caption = "the tool of pose {} is {} from where it was measured"
        largest = "whose tool was farthest from where it was measured"
        target, there = "where the instrument measured it", "as measured"
    else:
        caption = "the loop of pose {} stays open by {}"
        largest = "whose loop was farthest from closing"
        target, there = "where it is held", f"{kind}, table"
    labels = there, f"{kind}, tool"
    drawn = [_layers(s, view, times, labels) for s in (before, after)]
    points = [np.array([layer.x, layer.y]) for layers in drawn for layer in layers]
    places = np.concatenate(points, axis=1)
    x, y = map_axes(("across", "up"), *places, unit=LENGTH.unit, aspect=ASPECT)

    def picture(when: str, gap: float, layers: Sequence[Layer]) -> Picture:
        size = Figure(gap, CLOSURE_LENGTH).with_unit
        title = f"{when}: {caption.format(numbers[worst], size)}"
        return Picture(
            ident=f"arm-{when.lower()}",
            title=title,
            description=f"{title}. The arm from its base to its tool, and the place where the tool should be.",
            x=x,
            y=y,
            layers=layers,
            aspect=ASPECT,
        )

    enlarged = f", drawn {times} times as wide," if times > 1 else ""
    return Pair(
        pictures=(picture("Before", sizes[0], drawn[0]), picture("After", sizes[1], drawn[1])),
        note=f"The arm at the readings of pose {numbers[worst]}, {largest} before; the gap{enlarged} is from the "
        f"tool to {target}.",
    )


def _seen(part: ClosureModel, x: FloatArray, q: FloatArray) -> _Seen | None:
    drawn, stands = part.drawn(x, q), part.fixture_axis(x)
    if drawn is None or stands is None:
        return None
    return _Seen(chain=drawn[0], hand_axis=drawn[1], pin=stands[0], pin_axis=stands[1])


def _view(points: FloatArray, up: FloatArray) -> FloatArray:
    """Return the axes (2, 3) of an upright picture: the level direction in which the points extend most, and `up`."""
    spread = points - points.mean(axis=0)
    # The horizontal axis is the level direction with the largest extent.
    level = spread - np.outer(spread @ up, up)
    right = np.linalg.svd(level)[2][0]
    return np.stack((right * np.sign(right[np.argmax(np.abs(right))]), up))


def _layers(
    seen: _Seen, view: FloatArray, times: int, labels: tuple[str, str]
) -> list[Polyline | Marks]:
    hand = seen.chain[-1]
    pin = hand + times * seen.gap
    ends = AXIS_M * np.array([[-1.0], [1.0]])

    def flat(points: FloatArray) -> tuple[list[float], list[float]]:
        across, up = (LENGTH.per_si * points @ view.T).T.tolist()
        return across, up

    def line(points: FloatArray, class_: str, label: str) -> Polyline:
        across, up = flat(points)
        return Polyline(x=across, y=up, class_=class_, label=label)

    joints, held = flat(seen.chain[:-1]), flat(pin[None, :])
    # A ball and a measured point have no axis: only a mark is drawn.
    turns, (label_there, own) = bool(np.any(seen.pin_axis)), labels
    axes = [
        line(pin + ends * seen.pin_axis, "dashed", label_there),
        line(hand + ends * seen.hand_axis, "b", own),
    ]
    at_pin = "" if turns else label_there
    return [
        *(axes if turns else ()),
        line(seen.chain, "a", "arm"),
        Marks(x=joints[0], y=joints[1]),
        line(np.stack((hand, pin)), "gap", "gap"),
        Marks(x=held[0], y=held[1], shape="triangle", class_="d", label=at_pin),
    ]
