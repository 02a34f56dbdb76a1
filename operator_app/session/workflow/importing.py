"""Makes sessions from the poses in a file or an array, without an arm.

Report, compare, verify and export work with such sessions; only resuming with an arm is refused.
"""

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import to_dict
from operator_app.config.arm_file import parse_arm
from operator_app.config.atomic import dump_strict, write_atomically
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.resources import Resource
from operator_app.errors import JournalError
from operator_app.session.store.folders import new_folder, next_order
from operator_app.session.store.journal import Clock, locked, read_journal, utc_now
from operator_app.session.store.journal_format import (
    JOURNAL_NAME,
    JournalEvent,
    format_lines,
    os_errors_as_journal_errors,
    utc_in_words,
    write_new_file,
)
from operator_app.session.store.replay import apply
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import solution_data, solve
from operator_app.session.workflow.opening import texts_of
from operator_app.units import plural
from solver.chain.poses import PoseSet

UNKNOWN_SERIAL_NUMBER = "unstated"
"""Serial number of an imported session if none is given."""

SPEED_DEG_PER_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOptions:
    """Options of the calibration of imported poses."""

    estimator: str = "implicit"
    unsensed_joints: tuple[int, ...] = ()
    length_tolerance_m: float | None = None
    drop_unidentifiable: bool = False


class ImportedSession:
    """A session made from the poses in a file or an array; it is only in memory until `write` is called.

    `file`: name of the source of the poses, for messages. `name`: name of the procedure and of the folder. Raises
    ConfigError if the arm file or the fixture file is not valid.
    """

    def __init__(
        self,
        poses: PoseSet,
        *,
        arm: Resource,
        fixture: Resource,
        file: str,
        name: str,
        serial_number: str = UNKNOWN_SERIAL_NUMBER,
        options: CalibrationOptions | None = None,
        clock: Clock = utc_now,
    ) -> None:
        options = CalibrationOptions() if options is None else options
        poses = _numbered(poses)
        slowest = min(j.max_speed_rad_per_s for j in parse_arm(arm.data, arm.file).joints)
        data = _procedure(name, math.degrees(slowest), len(poses), options)
        procedure = parse_procedure(
            Resource(file="import", folder=None, data=data),
            snapshot={"arm": arm, "fixture": fixture},
        )
        self.procedure = replace(procedure, length_tolerance_m=options.length_tolerance_m)
        self.state = SessionState()
        self._clock = clock
        self._events: list[JournalEvent] = []
        settings = {
            "length_tolerance_m": options.length_tolerance_m,
            "drop_unidentifiable": options.drop_unidentifiable or None,
        }
        opened = {
            "sources": texts_of(procedure),
            "settings": {key: value for key, value in settings.items() if value is not None},
        }
        self._record("opened", opened)
        self._record("imported", {"file": file, "serial_number": serial_number})
        for k in range(len(poses)):
            self._record("pose", _pose(poses, k))

    def calibrate(self) -> tuple[Solution, Checks]:
        """Calibrate, cross-validate, record both results and return them; raises SolverError, FixtureError."""
        own = self.procedure
        solution = solve(self.state, own)
        checks = check(solution, own.arm, own.fixture.fixture, self.state.pose_set())
        self.add(solution, checks)
        return solution, checks

    def add(self, solution: Solution, checks: Checks | None) -> None:
        """Record a solution computed from this session's poses, and the `checks` of its cross-validation, if any."""
        self._record("solved", solution_data(solution, self.state, self.procedure))
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
        """Write the journal into `folder`, or into a new folder below `root`; return the folder.

        A session of imported poses in `folder` is replaced if its data are the same or `overwrite` is true. First, the
        files named in `stale` are removed. Raises JournalError or WriteError if replacing or writing fails.
        """
        if folder is None:
            folder = new_folder(
                Path("sessions") if root is None else root, self.procedure.name, self._clock()
            )
        self._record("closed", {"reason": "imported"})
        opened, *others = self._events
        order = next_order(folder)
        lines = format_lines((replace(opened, data={**opened.data, "order": order}), *others))
        path = folder / JOURNAL_NAME
        remedy = "choose a folder with free space and write permission"
        with os_errors_as_journal_errors(f"cannot write {path}", remedy), suppress(FileExistsError):
            folder.mkdir(parents=True, exist_ok=True)
            write_new_file(path, b"".join(lines))
            return folder
        self._replace_session(folder, lines, overwrite=overwrite, stale=stale)
        return folder

    def _replace_session(
        self, folder: Path, lines: Sequence[bytes], *, overwrite: bool, stale: Sequence[str]
    ) -> None:
        """Replace the journal in `folder` with `lines`, after removing the files named in `stale`.

        Raises WriteError if writing fails. Raises JournalError, and changes nothing, in these cases:

        - The old journal contains events other than `REPRODUCIBLE_EVENTS`: it was captured on an arm, or edited.
        - Its poses, arm or fixture differ from the new ones, and `overwrite` is false.
        - It cannot be read, or is in use.
        """
        path = folder / JOURNAL_NAME
        with locked(path):
            existing = read_journal(folder).events
            names = {event.name for event in existing}
            if "imported" not in names or not names <= REPRODUCIBLE_EVENTS:
                raise JournalError(
                    f"{folder} holds a session captured on an arm, or edited",
                    "name another folder: such a session is not replaced even with overwrite=True",
                )
            if not overwrite and _contents(existing) != _contents(self._events):
                poses = plural(sum(event.name == "pose" for event in existing), "pose")
                raise JournalError(
                    f"{folder} already holds a session of other data ({poses})",
                    "name another folder, or replace it with save(folder, overwrite=True)",
                )
            for name in stale:
                # Removed before the journal is replaced: no file of the old calibration is ever beside the new journal.
                (folder / name).unlink(missing_ok=True)
            write_atomically(path, b"".join(lines))

    def _record(self, name: str, data: Mapping[str, Any]) -> None:
        utc = utc_in_words(self._clock())
        event = JournalEvent(seq=len(self._events) + 1, utc=utc, name=name, data=data)
        self._events.append(event)
        self.state = apply(self.state, event)


def _numbered(poses: PoseSet) -> PoseSet:
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
    record: dict[str, Any] = {
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
        record["endpoint"] = poses.endpoint[k].tolist()
    return record


def _procedure(
    name: str, slowest_deg_per_s: float, poses: int, options: CalibrationOptions
) -> bytes:
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:48]
    if not re.match(r"[A-Za-z]", name):
        name = f"poses-{name}".rstrip("-")
    return dump_strict(
        {
            "schema": "sarcal/procedure/1",
            "name": name,
            "arm": "arm",
            "fixture": "fixture",
            "bus": {"interface": "virtual"},
            "modes": "auto",
            **(
                {"unsensed_joints": list(options.unsensed_joints)}
                if options.unsensed_joints
                else {}
            ),
            "capture": {
                "poses": poses,
                "speed_deg_per_s": min(SPEED_DEG_PER_S, slowest_deg_per_s),
                "settle": {"window_syncs": 20, "spread_sigmas": 8.0, "timeout_syncs": 1000},
                "samples_per_pose": 1,
            },
            "estimator": options.estimator,
            "acceptance": {"scaled_condition_number": 100.0},
            "export": {"upload": False},
        },
        comment="Made by an import: these poses come from a file, not from an arm.",
    )


REPRODUCIBLE_EVENTS = frozenset(
    {"opened", "imported", "pose", "solved", "checked", "exported", "closed"}
)
"""A session that contains only such events can be made again from its poses."""


def _contents(events: Sequence[JournalEvent]) -> list[Any]:
    contents: list[Any] = []
    for event in events:
        match event.name:
            case "opened":
                sources = event.data["sources"]
                contents += [sources.get(kind) for kind in ("arm", "fixture")]
            case "imported":
                contents.append(event.data["serial_number"])
            case "pose":
                contents.append(dict(event.data))
    return contents
