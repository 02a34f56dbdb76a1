"""A session made of poses that no arm of ours took: a file's, an array's. Knows no arm and no renderer.

Its journal holds what one of an arm holds, the documents and every pose, so that report, compare, verify
and export work on it; only to go on with an arm is refused.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from operator_app.calibration.closed_loops import loop_of_poses
from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import to_dict
from operator_app.config.arm_file import parse_arm
from operator_app.config.atomic import write_atomically
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.resources import Resource
from operator_app.config.yaml_writer import dump_strict
from operator_app.errors import JournalError
from operator_app.session.store.folders import new_folder, next_order
from operator_app.session.store.journal import Clock, lock, read_journal, utc_now
from operator_app.session.store.journal_files import write_new
from operator_app.session.store.journal_format import JOURNAL_NAME, JournalEvent, line_of
from operator_app.session.store.replay import apply
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import solve, solved_data
from operator_app.session.workflow.opening import KINDS
from operator_app.units.numbers import plural
from solver.chain.poses import PoseSet
from solver.loops.closure import ClosureModel

UNSTATED = "unstated"
"""Serial number of an arm that nobody named."""

SPEED_DEG_PER_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class How:
    """How imported poses are calibrated, where it differs from the defaults."""

    estimator: str = "implicit"
    unsensed_joints: tuple[int, ...] = ()
    length_tolerance_m: float | None = None
    drop_unidentifiable: bool = False


class ImportedSession:
    """A session in the making: what its journal will hold, in memory until it is written.

    Parameters
    ----------
    arm, fixture
        The documents, as found.
    file
        Where the poses come from, in words.
    name
        Of the procedure, and so of the folder.

    Raises
    ------
    ConfigError
        The documents are wrong.
    """

    def __init__(
        self,
        poses: PoseSet,
        *,
        arm: Resource,
        fixture: Resource,
        file: str,
        name: str,
        serial_number: str = UNSTATED,
        how: How | None = None,
        clock: Clock = utc_now,
    ) -> None:
        how = How() if how is None else how
        poses = _as_kept(poses)
        slowest = min(j.max_speed_rad_per_s for j in parse_arm(arm.data, arm.file).joints)
        data = _procedure(_plain(name), math.degrees(slowest), len(poses), how)
        procedure = parse_procedure(
            Resource(file="import", folder=None, data=data),
            snapshot={"arm": arm, "fixture": fixture},
        )
        self.procedure = replace(procedure, length_tolerance_m=how.length_tolerance_m)
        self.state = SessionState()
        self._clock = clock
        self._events: list[JournalEvent] = []
        sources = zip(KINDS, procedure.sources, strict=True)
        settings = {
            "length_tolerance_m": how.length_tolerance_m,
            "drop_unidentifiable": how.drop_unidentifiable or None,
        }
        opened = {
            "sources": {kind: source.data.decode() for kind, source in sources},
            "settings": {key: value for key, value in settings.items() if value is not None},
        }
        self._record("opened", opened)
        self._record("imported", {"file": file, "serial_number": serial_number})
        for k in range(len(poses)):
            self._record("pose", _pose(poses, k))

    @property
    def model(self) -> ClosureModel:
        """The loops of its poses."""
        own = self.procedure
        return loop_of_poses(
            own.arm,
            own.fixture.fixture,
            self.state.pose_set(),
            unsensed_joints=own.unsensed_joints,
        )

    def calibrate(self) -> tuple[Solution, Checks]:
        """Solve the poses, and ask for second opinions; raises SolverError, FixtureError."""
        own = self.procedure
        found = solve(self.state, own, estimator=own.estimator, unsensed_joints=own.unsensed_joints)
        checks = check(found, own.arm, own.fixture.fixture, self.state.pose_set())
        self.add(found, checks)
        return found, checks

    def add(self, solution: Solution, checks: Checks | None) -> None:
        """Keep a solution of these poses."""
        tolerance = self.procedure.length_tolerance_m
        self._record("solved", solved_data(solution, self.state, length_tolerance_m=tolerance))
        if checks is not None:
            self._record("checked", {"record": to_dict(checks)})

    def write(
        self,
        *,
        root: Path | None = None,
        folder: Path | None = None,
        overwrite: bool = False,
        stale: Sequence[str] = (),
    ) -> Path:
        """Write the journal into `folder`, or into one named by the time below `root`; return it.

        What may be in `folder` already says `saving_again`; files named `stale` in it go then.

        Raises
        ------
        JournalError
            There is a session that stays, or nothing can be written.
        """
        if folder is None:
            folder = new_folder(
                Path("sessions") if root is None else root, self.procedure.name, self._clock()
            )
        self._record("closed", {"reason": "imported"})
        lines = self._lines(next_order(folder.parent, but=folder))
        path = folder / JOURNAL_NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_new(path, b"".join(lines))
        except FileExistsError:
            replace_session(folder, lines, self._events, overwrite=overwrite, stale=stale)
        except OSError as error:
            raise JournalError(
                f"cannot write {path}: {error.strerror}", "choose a folder you may write to"
            ) from error
        return folder

    def _lines(self, order: int) -> list[bytes]:
        """Lines of the journal of a session that is number `order` of its folder."""
        opened, *others = self._events
        opened = replace(opened, data={**opened.data, "order": order})
        lines, chain = list[bytes](), ""
        for event in (opened, *others):
            line, chain = line_of(event, chain)
            lines.append(line)
        return lines

    def _record(self, name: str, data: Mapping[str, Any]) -> None:
        utc = self._clock().isoformat(timespec="milliseconds").replace("+00:00", "Z")
        event = JournalEvent(seq=len(self._events) + 1, utc=utc, name=name, data=data)
        self._events.append(event)
        self.state = apply(self.state, name, data, utc)


def _as_kept(poses: PoseSet) -> PoseSet:
    """Poses numbered as a session numbers them, their own names in the notes."""
    numbers = tuple(str(k) for k in range(1, len(poses) + 1))
    if poses.label == numbers:
        return poses
    several = len(poses.placements) > 1
    names = (
        f"pose {label}" + (f" of placement {placement}" if several else "")
        for placement, label in poses.keys
    )
    noted = poses.notes or ("",) * len(poses)
    notes = tuple("; ".join(filter(None, pair)) for pair in zip(names, noted, strict=True))
    return replace(poses, label=numbers, notes=notes)


def _pose(poses: PoseSet, k: int) -> dict[str, Any]:
    n = poses.joint_count
    found: dict[str, Any] = {
        "number": k + 1,
        "waypoint": -1,
        "mean_rad": poses.q_rad[k].tolist(),
        "sd_rad": [0.0] * n if poses.sd_rad is None else poses.sd_rad[k].tolist(),
        "samples": 1 if poses.samples is None else int(poses.samples[k]),
        "note": "" if poses.notes is None else poses.notes[k],
        "placement": int(poses.placement[k]),
        "taken_utc": "" if poses.utc is None else poses.utc[k],
    }
    if poses.endpoint is not None:
        found["endpoint"] = poses.endpoint[k].tolist()
    return found


def _plain(name: str) -> str:
    """Make a name of a procedure out of that of a file."""
    found = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:48]
    return found if re.match(r"[A-Za-z]", found) else f"poses-{found}".rstrip("-")


def _procedure(name: str, slowest_deg_per_s: float, poses: int, how: How) -> bytes:
    """Write the procedure that a session of these poses would have followed."""
    return dump_strict(
        {
            "schema": "sarcal/procedure/1",
            "name": name,
            "arm": "arm",
            "fixture": "fixture",
            "bus": {"interface": "virtual"},
            "modes": "auto",
            **({"unsensed_joints": list(how.unsensed_joints)} if how.unsensed_joints else {}),
            "capture": {
                "poses": poses,
                "speed_deg_per_s": min(SPEED_DEG_PER_S, slowest_deg_per_s),
                "settle": {"window_syncs": 20, "spread_sigmas": 8.0, "timeout_syncs": 1000},
                "samples_per_pose": 1,
            },
            "estimator": how.estimator,
            "acceptance": {"scaled_condition_number": 100.0},
            "export": {"upload": False},
        },
        comment="Made by an import: these poses were in a file, and no arm of this program took them.",
    )


MADE_AGAIN = frozenset({"opened", "imported", "pose", "solved", "checked", "exported", "closed"})
"""Events that hold nothing which the poses' owner cannot make again."""


def replace_session(
    folder: Path,
    lines: Sequence[bytes],
    events: Sequence[JournalEvent],
    *,
    overwrite: bool,
    stale: Sequence[str],
) -> None:
    """Put these lines where `folder` holds a journal, if that may go; the files named `stale` go first.

    One of the same poses, arm and fixture goes without a word; one of others where `overwrite` says so.

    Raises
    ------
    JournalError
        It holds what cannot be made again, or something else than these poses; it cannot be read, or
        somebody works on it. Nothing was changed then.
    WriteError
        The disk refuses.
    """
    path = folder / JOURNAL_NAME
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise JournalError(
            f"cannot open {path}: {error.strerror}", "name another folder"
        ) from error
    lock(descriptor, path)
    try:
        there = read_journal(folder)
        _require_made_again(folder, there.events)
        if _of_what(there.events) != _of_what(events):
            _require_wanted(folder, there.events, overwrite=overwrite)
        for name in stale:
            # Before the journal: a file of the old calibration never lies beside the new one.
            (folder / name).unlink(missing_ok=True)
        write_atomically(path, b"".join(lines))
    finally:
        os.close(descriptor)


def _require_made_again(folder: Path, events: Sequence[JournalEvent]) -> None:
    names = {event.name for event in events}
    if "imported" in names and names <= MADE_AGAIN:
        return
    raise JournalError(
        f"{folder} holds a session of an arm, or one that somebody worked on",
        "name another folder: what was taken once is not written over, with overwrite=True either",
    )


def _require_wanted(folder: Path, events: Sequence[JournalEvent], *, overwrite: bool) -> None:
    if overwrite:
        return
    poses = plural(sum(event.name == "pose" for event in events), "pose")
    raise JournalError(
        f"there is a session in {folder} already, of other data ({poses})",
        "name another folder, or say that it may go: save(folder, overwrite=True)",
    )


def _of_what(events: Sequence[JournalEvent]) -> list[Any]:
    """What a session was made of: the arm's file and number, the fixture's file, every pose."""
    found: list[Any] = []
    for event in events:
        match event.name:
            case "opened":
                sources = event.data["sources"]
                found += [sources.get(kind) for kind in ("arm", "fixture")]
            case "imported":
                found.append(event.data["serial_number"])
            case "pose":
                found.append(dict(event.data))
    return found
