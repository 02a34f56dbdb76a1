"""Scrolling lists with a header, among them the live list of joints."""

from collections.abc import Mapping, Sequence

from hardware.arm import DriveState, JointMode, JointState
from operator_app.report.spans import Line, Span, length, line, window
from operator_app.report.table import FactTable
from operator_app.report.text import table_spans
from operator_app.session.ui.snapshot import STALE_S, DataState, SessionSnapshot
from operator_app.tui.lines import Lines
from operator_app.units import DATA_AGE, JOINT_SPEED, JOINT_TORQUE, POSITION, WHOLE_DEGREES
from solver.chain.arm_model import Joint
from solver.chain.sensors import Encoder, NoSensor, Rvdt, Sensor


class ListPanel(Lines):
    """A list; subclasses override `_head`, `_count` and `_row`. `cursor`: marked row, always visible."""

    cursor = 0
    _last = 0

    def _head(self, s: SessionSnapshot, width: int) -> Sequence[Line]:
        """Return the header lines, which are not scrolled."""
        return ()

    def _count(self, s: SessionSnapshot) -> int:
        return 0

    def _row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        """Return the lines of row `k` (from 0)."""
        return ()

    def move(self, by: int) -> None:
        """Move the cursor by `by` rows."""
        self.cursor = max(0, min(self._last, self.cursor + by))

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        head, count = self._head(s, width), self._count(s)
        room = max(1, height - len(head))
        self._last = max(0, count - 1)
        self.cursor = min(self.cursor, self._last)
        first = max(0, min(self.cursor - room // 2, count - room))
        visible = range(first, min(count, first + room))
        return [*head, *(line for k in visible for line in self._row(s, k, width))]


class TablePanel(ListPanel):
    """A scrolling table; subclasses override `_table`. No row is marked: `cursor` is the first visible row."""

    def _table(self, s: SessionSnapshot) -> FactTable | None:
        return None

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        table = self._table(s)
        head, body = ([], []) if table is None else table_spans(table)
        rows, shown, self.cursor = window(body, self.cursor, max(1, height - len(head)))
        self._last = len(body) - shown
        return [*head, *rows]


NEAR_END = 0.04
"""A joint is marked as near its limit within this fraction of its range from either end."""

_DRIVES = {
    DriveState.OPERATION_ENABLED: "ok",
    DriveState.QUICK_STOP_ACTIVE: "STOP",
    DriveState.FAULT: "FAULT",
    DriveState.FAULT_REACTION_ACTIVE: "FAULT",
}
_SENSORS: Mapping[type[Sensor], str] = {Encoder: "enc", Rvdt: "RVDT", NoSensor: "none"}


class JointTable(ListPanel):
    """List of joints. `show_selected`: mark a row, and show sensor and requested mode instead of speed and state."""

    TITLE = "Joints"

    def __init__(self, *, id: str | None = None, show_selected: bool = False) -> None:  # noqa: A002
        super().__init__(id=id)
        self.show_selected = show_selected

    def _count(self, s: SessionSnapshot) -> int:
        return s.procedure.arm.joint_count

    def _cells(self, width: int) -> int:
        return max(7, min(13, width - (58 if self.show_selected else 68)))

    def _head(self, s: SessionSnapshot, width: int) -> Sequence[Line]:
        bar = "-range+".center(self._cells(width))
        titles = f"  JOINT         MODE     POS[deg] V[deg/s] T[N m] {bar} STATE"
        if self.show_selected:
            titles = f"  JOINT         SENS WANTED   ACTUAL    POS[deg] T[N m] {bar}"
        return [line((titles, "header"))]

    def _row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        joint, state = s.procedure.arm.joints[k], s.arm.joints[k] if s.arm is not None else None
        marked = self.show_selected and k == self.cursor
        spans: list[Span] = []

        def add(text: str, role: str = "text") -> None:
            spans.append((text, f"cursor {role}" if marked else role))

        name = f"J{k + 1} {joint.name}"[:13].ljust(13)
        add("▌ " if marked else "  ")
        add(name + " ")
        if self.show_selected:
            drives = k + 1 in s.selected_joints
            requested = JointMode.POSITION if drives else JointMode.FREE
            add(_SENSORS[type(joint.sensor)].ljust(5), "dim")
            add(_mode(requested).ljust(9), "accent" if drives else "text")
        if state is None:
            add("no data".ljust(9), "dim")
            return [tuple(spans)]
        stale = state.age_s > STALE_S
        role = "warn" if stale else "text"
        in_position = state.mode is JointMode.POSITION and s.drives_ready
        add(_mode(state.mode).ljust(9), "accent" if in_position else "text")
        add(f"{'?' if stale else ' '}{POSITION(state.position_rad).shown:>8}", role)
        if not self.show_selected:
            speed = "?"
            if s.motion is not None and not stale:
                speed = JOINT_SPEED(float(s.motion.speed_rad_per_s[k])).shown
            add(f" {speed:>7}", role)
        torque = "?" if stale else JOINT_TORQUE(state.torque_nm).shown
        heavy = abs(state.torque_nm) > 0.6 * joint.max_torque_nm and not stale
        add(f" {torque:>6}{'▲' if heavy else ' '}", "warn" if stale or heavy else "text")
        add(_bar(state.position_rad, joint, self._cells(width)))
        if not self.show_selected:
            word, figure, role = _state(s, state, joint, stale=stale)
            state_text = f"{word} {figure}" if figure else word
            fits = length(tuple(spans)) + 1 + len(state_text) <= width
            add(f" {state_text if fits else word}", role)
        return [tuple(spans)]


def _bar(position_rad: float, joint: Joint, cells: int) -> str:
    share = (position_rad - joint.lower_rad) / (joint.upper_rad - joint.lower_rad)
    inner = cells - 2
    body = ["─"] * inner
    body[inner // 2] = "┼"
    body[min(inner - 1, max(0, int(share * inner)))] = "●"
    return "├" + "".join(body) + "┤"


def _state(
    s: SessionSnapshot, state: JointState, joint: Joint, *, stale: bool
) -> tuple[str, str, str]:
    if stale:
        word = "LOST" if s.data is DataState.LOST else "STALE"
        return f"▲ {word}", DATA_AGE(state.age_s).with_unit, "warn"
    word = _DRIVES.get(state.drive, "disabled")
    if word != "ok":
        return (f"■ {word}", "", "alarm") if word != "disabled" else ("· off", "", "dim")
    span = joint.upper_rad - joint.lower_rad
    if state.position_rad < joint.lower_rad + NEAR_END * span:
        return "▲ LIMIT", WHOLE_DEGREES(joint.lower_rad).with_unit, "alarm"
    if state.position_rad > joint.upper_rad - NEAR_END * span:
        return "▲ LIMIT", WHOLE_DEGREES(joint.upper_rad).with_unit, "alarm"
    return "ok", "", "dim"


def _mode(mode: JointMode | None) -> str:
    return "—" if mode is None else mode.value.upper()
