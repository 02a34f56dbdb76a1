"""Step 4, Capture: state of the arm, captured poses and their quality so far."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from statistics import median

import numpy as np

from operator_app.report.facts import CONDITION_PAPER
from operator_app.report.spans import Line, clip, line, short_entry, wrapped_entry
from operator_app.session.ui.snapshot import DataState, SessionSnapshot, TaskKind
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.list_panel import JointTable, ListPanel
from operator_app.tui.widgets.pictures import ArmView, sparkline
from operator_app.units import CONDITION, JOINT_SPEED, PREDICTED, READING_SD, SPAN, TARGET
from solver.chain.arm_model import Joint


class StillPanel(Lines):
    """The target of the motion, and whether the arm is at standstill."""

    TITLE = "Next pose"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        target = wrapped_entry("Target", _target(s), width, column=11)
        shown = [*target[: height - 2], *target[height - 2 :][:1]]
        cut_off = len(target) > len(shown)
        shown[-1] = (*shown[-1], (" …" if cut_off else "", "dim"))
        return [*(clip(row, width) for row in shown), clip(_still(s), width)]


def _target(s: SessionSnapshot) -> str:
    if s.task is not None and s.task.planning:
        return "none yet: the next poses are being planned"
    if s.heading is not None:
        return f"{_angles(s.heading.targets_rad)}: {s.heading.why}"
    planned = s.procedure.capture.strategy == "planned"
    if planned and len(s.state.used_poses) >= s.required_poses > 0:
        return "none: the plan is complete"
    if s.chooses_by_plan and s.task is not None:
        return "none of the plan now: see the messages"
    if s.next_waypoint is None or not s.plan:
        return "none left" if s.plan else "no plan yet"
    target = f"waypoint {s.next_waypoint + 1}: {_angles(s.plan[s.next_waypoint])}"
    if s.chooses_by_plan:
        return f"a: chosen by the plan; g: {target}"
    return target if s.at_waypoint is None else f"{target}, now at waypoint {s.at_waypoint + 1}"


def _angles(targets_rad: Mapping[int, float]) -> str:
    angles = "  ".join(f"J{j}\xa0{TARGET(v).shown}" for j, v in targets_rad.items())
    return f"{angles} {TARGET.quantity.unit}"


def _still(s: SessionSnapshot) -> Line:
    motion = s.motion
    if motion is None or s.data is not DataState.FRESH:
        return short_entry("Motion", ("no fresh data", "warn"))
    if not motion.still:
        k = int(np.argmax(np.abs(motion.speed_rad_per_s)))
        speed = JOINT_SPEED(float(motion.speed_rad_per_s[k])).with_unit
        return short_entry("Motion", f"{'○' * 10} moving, J{k + 1} at {speed:>13}")
    ready = motion.held_s >= motion.needed_s
    full = 10 if ready else int(10 * motion.held_s / motion.needed_s)
    return short_entry(
        "Motion",
        f"{'●' * full}{'○' * (10 - full)} still {min(motion.held_s, 99.9):4.1f} s, ",
        f"spread {100 * motion.spread_share:3.0f} % of limit (J{motion.worst_joint})",
    )


class PosesPanel(ListPanel):
    """All poses, newest first."""

    TITLE = "Captured"

    def _count(self, s: SessionSnapshot) -> int:
        return len(s.state.poses)

    def _head(self, s: SessionSnapshot, width: int) -> Sequence[Line]:
        sd, closure_unit = READING_SD.quantity.unit, PREDICTED.quantity.unit
        titles = line((f"    #  TIME      NOISE [{sd}]  PRED [{closure_unit}]  NOTE", "header"))
        return [titles] if s.state.poses else [titles, line(("    no pose yet", "dim"))]

    def _row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        pose, is_marked = s.state.poses[-1 - k], k == self.cursor
        before = s.state.poses[-2 - k] if k + 1 < len(s.state.poses) else pose
        first = f"placement {pose.placement} begins " if pose.placement != before.placement else ""
        noise = READING_SD(float(pose.sd_rad.max())).shown
        predicted_m = s.live.predicted_m.get(pose.number) if s.live is not None else None
        predicted = "—" if predicted_m is None else PREDICTED(predicted_m).shown
        note = first + ("✗ excluded " if pose.excluded else "") + pose.note
        back = "cursor " if is_marked else ""
        text = f"{pose.number:>4}  {pose.utc[11:19]}  {noise:>11}  {predicted:>9}  {note}"
        role = "dim" if pose.excluded else "text"
        return [line(("▌" if is_marked else " ", back + "text"), (text, back + role))]


class ProgressPanel(Lines, can_focus=False):
    """Progress and remaining time."""

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        used, total = len(s.state.used_poses), s.required_poses
        placement = f"Placement {s.state.placement}  " if s.state.placement > 1 else ""
        head = f" {placement}Poses {used:>2}/{total}  "
        tail = f"  {100 * used // max(1, total):>3} %  {_time_left(s)}"
        cells = max(4, width - len(head) - len(tail) - 1)
        full = min(cells, cells * used // max(1, total))
        return [line(head, ("━" * full, "accent"), ("─" * (cells - full), "dim"), tail)]


def _time_left(s: SessionSnapshot) -> str:
    used, total = s.state.used_poses, s.required_poses
    if len(used) >= total:
        return "complete    "
    if s.task is None or s.task.kind is not TaskKind.AUTOMATIC:
        return " " * 12
    if s.procedure.capture.strategy == "planned" and not s.state.campaign.begun:
        return "exploring   "  # the number of exploration poses is not known in advance
    times = [datetime.fromisoformat(p.utc) for p in used[-8:]]
    run_s = s.now_s - s.task.started_s
    times = [time for time in times if (times[-1] - time).total_seconds() < run_s]
    if len(times) < 3:
        return " " * 12
    each_s = median((later - sooner).total_seconds() for sooner, later in pairwise(times))
    seconds = each_s * (total - len(used))
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d} min left"


class QualityPanel(Lines):
    """Condition number, weakest parameters, and coverage of the joint ranges."""

    TITLE = "What the poses determine"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        live, names = s.live, 3 if width > 40 else 2
        history = () if live is None else live.history
        weakest = " ".join(live.weakest[:names]) if live is not None else ""
        best = "—" if s.best_waypoint is None else f"waypoint {s.best_waypoint + 1} (b)"
        if s.procedure.capture.strategy == "planned":
            best = "the plan's (a)"
        joints = s.procedure.arm.joints
        spans = live.coverage if live is not None and live.coverage else [None] * len(joints)
        bars = (
            _coverage(k, joint, span, width)
            for k, (joint, span) in enumerate(zip(joints, spans, strict=True), 1)
        )
        return [
            _condition(s, width),
            _trend([c for _, c in history], width) if history else line((" trend  —", "dim")),
            clip(line((" weak  ", "dim"), weakest or "—"), width),
            line((" best next ", "dim"), best),
            line((" coverage of joint ranges", "dim")),
            *bars,
        ]


def _trend(values: Sequence[float], width: int) -> Line:
    first, last = (CONDITION(v).shown for v in (values[0], values[-1]))
    if len(values) == 1:
        return line((" trend  ", "dim"), last)
    room = width - len(" trend  " + first + last) - 3
    return line((" trend  ", "dim"), f"{first} ", sparkline(values, room), f" {last}")


def _condition(s: SessionSnapshot, width: int) -> Line:
    live = s.live
    if live is None or not live.history:
        needed = "" if live is None else f" (from {live.needed} poses on)"
        return line((" condition ", "dim"), ("—", "text"), (needed, "dim"))
    value = live.scaled_condition_number
    shown = CONDITION(value).shown
    limit = s.procedure.acceptance.scaled_condition_number
    good = value <= limit
    role, word = ("bold", "ok") if good else ("warn", f"▲ over {limit:g}")
    if not good and len(s.state.used_poses) < s.required_poses:
        # Later poses reduce the condition number: no remedy is needed.
        role, word = "bold", "so far"
    more = f" (paper {CONDITION_PAPER})" if good else ""
    if width > 40:
        more = f" (limit {limit:g}, paper {CONDITION_PAPER})"
    return clip(line((" condition ", "dim"), (f"{shown} {word}", role), (more, "dim")), width)


def _coverage(number: int, joint: Joint, span: tuple[float, float] | None, width: int) -> Line:
    cells = max(6, width - 16)
    bar, text = "─" * cells, "—"
    if span is not None:
        full = joint.upper_rad - joint.lower_rad
        first, last = (int((end - joint.lower_rad) / full * cells) for end in span)
        bar = "".join("█" if first <= k <= last else "─" for k in range(cells))
        text = SPAN(span[1] - span[0]).shown
    return line((f" J{number} ", "dim"), f"├{bar}┤{text:>6} {SPAN.quantity.unit}")


class CaptureView(StepView):
    """View of step 4: joints, target, poses, drawing, quality."""

    PANELS = (
        {
            "capture-joints": JointTable,
            "still": StillPanel,
            "poses": PosesPanel,
            "progress": ProgressPanel,
        },
        {"capture-arm": ArmView, "quality": QualityPanel},
    )
    MAIN = "poses"
    VIEWS = (("capture-joints", "still", "poses", "progress"), ("quality",), ("capture-arm",))

    def marked_pose(self, s: SessionSnapshot) -> int | None:
        """Number of the marked pose; None if there is no pose."""
        poses = s.state.poses
        return poses[-1 - min(self.main.cursor, len(poses) - 1)].number if poses else None
