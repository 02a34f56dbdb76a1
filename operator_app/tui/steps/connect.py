"""Step 1, Connect: the bus, the nodes that answer, and the check of the arm's identity."""

from collections.abc import Sequence

from hardware.arm import NodeIdentity
from operator_app.messages.errors import drive_words
from operator_app.report.spans import Line, line, short_entry, wrapped
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.status import HEARTBEAT_LATE_S
from operator_app.units import DATA_AGE


class _BusPanel(Lines):
    TITLE = "Bus"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        rate = f"{s.sync_rate_hz:.0f} SYNC/s" if s.connected else "not connected"
        session = str(s.folder)
        return [
            short_entry("Bus", s.bus, ("   " + rate, "text")),
            short_entry("Procedure", f"{s.procedure.name}: {s.procedure.arm.name} in "
                 f"{s.procedure.fixture.name}, {s.required_poses} poses", ("   (p: another)", "dim")),
            short_entry("Session", session if len(session) < width - 12 else "…" + session[-width + 13:]),
        ]  # fmt: skip


class NodesPanel(Lines):
    """The nodes on the bus."""

    TITLE = "Nodes"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        if s.identity is None:
            return [(), line(("  no arm is connected", "dim"))]
        wide = width >= 90 and not s.drive_faults  # a fault takes the space of the device name
        device = "DEVICE".ljust(26) + " " if wide else ""
        titles = f"  NODE  ROLE        {device} SERIAL  HEARTBEAT      DATA  STATE"
        return [line((titles, "header")), *(_node(s, node, wide=wide) for node in s.identity.nodes)]


def _node(s: SessionSnapshot, node: NodeIdentity, *, wide: bool) -> Line:
    beat = None if s.arm is None else s.arm.heartbeat_age_s.get(node.node)
    joints = () if s.arm is None else s.arm.joints
    joint = next((j for j in joints if node.role == f"joint {j.joint}"), None)
    heartbeat = "     —" if beat is None else f"{DATA_AGE(beat).with_unit:>7}"
    age = "     —" if joint is None else f"{DATA_AGE(joint.age_s).with_unit:>7}"
    device = f"{node.device_name[:26]:<26} " if wide else ""
    late = beat is not None and beat > HEARTBEAT_LATE_S
    state, role = "● answers", "warn" if late else "text"
    if joint is not None:
        state += f", drive {drive_words(joint.drive)}"
        if (fault := s.drive_faults.get(joint.joint)) is not None:
            state, role = f"■ fault {fault}".rstrip(), "alarm"
    return line(
        f"  {node.node:>4}  {node.role[:11]:<11} {device}{node.serial_number:>7}  ",
        (f"{heartbeat:>9}  ", "warn" if late else "text"),
        (f"{age:>7}  ", "text"),
        (f"▲ LATE, {state}" if late else state, role),
    )


class _CheckPanel(Lines):
    TITLE = "Check"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        rows: list[Line] = []
        arm = s.identity
        if arm is not None:
            text = f"{len(arm.nodes)} nodes answer, arm {arm.model}, serial {arm.serial_number}"
            rows.append(line(" ✓ ", text))
            if arm.speaks == "CANopen":
                rows.append(line(" ✓ ", "no other operator on the bus"))
        else:
            rows.append(line((" ○ ", "dim"), "arm not connected yet"))
        if s.simulated or (arm is not None and arm.by_hand):
            reason = "nothing real moves" if s.simulated else "a person moves it"
            rows.append(line(" ✓ ", (f"hardware stop: none needed, {reason}", "dim")))
        elif s.stop_tested:
            rows.append(line(" ✓ ", "hardware stop tested in this run"))
        else:
            rows += wrapped(
                " ○ hardware stop: press it, see every drive switch off, release it, then t", width
            )
        return rows


class ConnectView(StepView):
    """View of step 1: bus, nodes, check."""

    PANELS = ({"bus": _BusPanel, "nodes": NodesPanel, "connect-check": _CheckPanel},)
