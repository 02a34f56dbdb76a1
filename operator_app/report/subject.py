"""The subject of a report: one session with its poses and calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from operator_app.messages.finding import Finding, FindingKind
from operator_app.report.facts import Facts, facts_of
from operator_app.session.store.replay import replay

if TYPE_CHECKING:
    from pathlib import Path

    from operator_app.calibration.cross_validation import Checks
    from operator_app.calibration.result import Solution
    from operator_app.config.procedure import Procedure
    from operator_app.session.store.journal_format import JournalContents
    from operator_app.session.store.state import CapturedPose, SessionState
    from operator_app.session.store.stored_calibration import StoredCalibration
    from operator_app.session.ui.snapshot import SessionSnapshot
    from solver.arrays import FloatArray
    from solver.errors import UnidentifiableError
    from solver.estimators.estimate import Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """The content of a report, before it is rendered.

    `solution`: the calibration; None if the poses do not determine every parameter.
    `checks`: cross-validation and jackknife; None if not computed.
    `unidentifiable`: the error that names the undetermined parameters; None if there is a solution.
    `recalculated_because`: why the poses were solved again; empty if the solution is from the journal.
    `last_utc`, `events`: time of the journal's last event, and number of all events.
    `torn`: text about an incomplete last line of the journal that was dropped; empty if the journal is complete.
    `simulated`: whether the drives report that they are virtual.
    """

    name: str
    procedure: Procedure
    state: SessionState
    solution: Solution | None
    checks: Checks | None
    unidentifiable: UnidentifiableError | None = None
    recalculated_because: str = ""
    last_utc: str = ""
    events: int = 0
    torn: str = ""
    simulated: bool = False
    software_version: str = field(default_factory=lambda: version("sarcal"))

    @property
    def poses(self) -> tuple[CapturedPose, ...]:
        """All captured poses, including excluded ones."""
        return self.state.poses

    @property
    def facts(self) -> Facts | None:
        """The facts of the calibration; None if there is no calibration."""
        if self.solution is None:
            return None
        return facts_of(
            self.solution.with_notices(self._about_the_session),
            checks=self.checks,
            limits=self.procedure.acceptance,
            captured=len(self.poses),
        )

    @property
    def notices(self) -> tuple[Finding, ...]:
        """Findings about the calibration and about the session that an operator should read."""
        findings = () if self.solution is None else self.solution.warnings
        return (*findings, *self._about_the_session)

    @property
    def _about_the_session(self) -> tuple[Finding, ...]:
        K, findings = FindingKind, []
        if (blind := self.unidentifiable) is not None:
            if blind.note:
                names, note = (blind.code,), (blind.note,)
                findings.append(Finding(kind=K.REPORTED, names=names, reported=note))
            texts = map(str, blind.directions)
            findings += [Finding(kind=K.NOT_IDENTIFIABLE, reported=(text,)) for text in texts]
        if self.torn:
            findings.append(Finding(kind=K.JOURNAL_TORN, reported=(self.torn,)))
        if self.recalculated_because and self.solution is not None:
            findings.append(Finding(kind=K.SOLVED_AGAIN, reported=(self.recalculated_because,)))
        if self.solution is not None and self.checks is None:
            findings.append(Finding(kind=K.NOT_CROSS_VALIDATED, names=(self.name,)))
        return tuple(findings)

    @property
    def implicit(self) -> Estimate | None:
        """The implicit estimator's estimate, even if only calculated for comparison; None if it was not calculated."""
        if self.solution is None:
            return None
        both = (self.solution.identified, self.solution.beside)
        return next((e for e in both if e is not None and e.estimator == "implicit"), None)

    @property
    def used(self) -> tuple[CapturedPose, ...]:
        """Poses from which the solution was calculated, in the same order as in the solution's arrays."""
        return tuple(p for p in self._counting if p.number not in self.flipped)

    @property
    def flipped(self) -> tuple[int, ...]:
        """Numbers of poses left out because the tool was upside down on the hinge (flipped branch)."""
        dropped = () if self.solution is None else self.solution.dropped_flipped
        return tuple(self._counting[k].number for k in dropped)

    @property
    def _counting(self) -> tuple[CapturedPose, ...]:
        return tuple(p for p in self.poses if not p.excluded)

    @property
    def readings_rad(self) -> FloatArray:
        """Mean readings of the poses used, (m, n), rad."""
        return np.array([p.mean_rad for p in self.used])

    @property
    def unsensed_joints(self) -> tuple[int, ...]:
        """Joints (from 1) whose readings were not used."""
        if self.solution is None:
            return self.procedure.unsensed_joints
        return self.solution.model.unsensed_joints


def subject_of_session(
    folder: Path,
    contents: JournalContents,
    procedure: Procedure,
    calibration: StoredCalibration | None,
    *,
    unidentifiable: UnidentifiableError | None = None,
) -> Subject:
    """Return the subject of a session, from its folder, the contents of its journal, its procedure and calibration.

    If the poses leave parameters undetermined, `calibration` is None and `unidentifiable` is the error that names them.
    """
    events = contents.events
    connected = (event for event in events if event.name == "connected")
    nodes = [node for event in connected for node in event.data.get("nodes", ())]
    return Subject(
        name=folder.resolve().name,
        procedure=procedure,
        state=replay(events),
        solution=None if calibration is None else calibration.solution,
        checks=None if calibration is None else calibration.checks,
        unidentifiable=unidentifiable,
        recalculated_because="" if calibration is None else calibration.recalculated_because,
        last_utc=events[-1].utc,
        events=len(events),
        torn=contents.torn,
        simulated=any("virtual" in str(node.get("device_name", "")) for node in nodes),
    )


def facts_on(s: SessionSnapshot) -> Facts | None:
    """Return the facts of a snapshot's calibration; None if the present poses have no calibration."""
    return _of_snapshot(_SnapshotKey(s))[0]


def subject_on(s: SessionSnapshot) -> Subject | None:
    """Return the report subject of a snapshot; None if the present poses have no calibration."""
    return _of_snapshot(_SnapshotKey(s))[1]


def no_facts(s: SessionSnapshot) -> str:
    """Return why a snapshot's present poses have no calibration; empty if there is a calibration."""
    if s.solution is None:
        return "no calibration of these poses yet"
    counting = sum(not pose.excluded for pose in s.state.poses)
    if counting != s.solution.poses + len(s.solution.dropped_flipped):
        return "the poses have changed since the calibration: calibrate again"
    return ""


class _SnapshotKey:
    """Cache key, equal for snapshots with the same facts. A screen redrawn 20 times per second builds facts once."""

    def __init__(self, s: SessionSnapshot) -> None:
        self.s = s
        self._parts = [*map(id, (s.solution, s.cross_checks, s.state.poses, s.state.modes))]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SnapshotKey) and self._parts == other._parts

    def __hash__(self) -> int:
        return id(self.s.solution)


@lru_cache(maxsize=2)
def _of_snapshot(of: _SnapshotKey) -> tuple[Facts | None, Subject | None]:
    s = of.s
    if s.solution is None or no_facts(s):
        return None, None
    solution, checks, limits = s.solution, s.cross_checks, s.procedure.acceptance
    facts = facts_of(solution, checks=checks, limits=limits, captured=len(s.state.poses))
    subject = Subject(
        name=s.folder.name,
        procedure=s.procedure,
        state=s.state,
        solution=solution,
        checks=checks,
        simulated=s.simulated,
    )
    return facts, subject
