"""Result of a calibration: values with units, tables, tool position, files."""

from collections.abc import Mapping
from copy import deepcopy
from datetime import datetime
from functools import cached_property
from os import PathLike, fspath
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from operator_app.calibration.calibrated_arm import CalibratedArm, Frame, calibrated_arm
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.config.atomic import write_atomically
from operator_app.config.parameters_file import ParametersDocument, save_parameters
from operator_app.config.poses_file import save_poses
from operator_app.config.resources import DESCRIPTION_LIMIT_BYTES, read_limited
from operator_app.errors import SessionError
from operator_app.report.exports import EXPORT_FILES, Calibration, in_format, into_description
from operator_app.report.facts import Facts, facts_of
from operator_app.report.html.markup import element, join, table_html
from operator_app.report.html.page import REPORT_NAME, report_html
from operator_app.report.plots.figure_files import PaperFigure, drawings
from operator_app.report.plots.figure_files import figure as draw_figure
from operator_app.report.subject import Subject, subject_of_session
from operator_app.report.text import facts_text
from operator_app.session.store.folders import PARAMETERS_NAME, POSES_NAME
from operator_app.session.store.journal import read_journal, utc_now
from operator_app.session.store.parameters_document import export_reason, parameters_document
from operator_app.session.store.stored_calibration import StoredCalibration
from operator_app.session.workflow.importing import CalibrationOptions, ImportedSession
from operator_app.session.workflow.opening import Opening
from solver.arrays import FloatArray
from solver.diagnostics.statistics import intervals

from .calls import one_of, readings_rad
from .machines import Arm, Fixture
from .poses import Poses
from .tables import Table, with_units

YAML = ("yaml", "yml")
"""File name endings of a parameters file."""


class Result:
    """A calibration, made by `calibrate` or read by `load_result`.

    Attributes
    ----------
    arm, fixture, poses
        Inputs of the calibration.

    Examples
    --------
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=30, seed=0)
    >>> result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)
    >>> result.accepted
    True
    >>> sorted(result.values)[:3]
    ['a_0_mm', 'a_7_mm', 'alpha_0_deg']
    >>> sigma_m = result.tip_sigma(made.poses.q_rad)
    >>> bool((sigma_m < 0.003).all())
    True
    """

    def __init__(
        self, *, arm: Arm, fixture: Fixture, poses: Poses, solution: Solution, checks: Checks | None,
        origin: CalibrationOptions | Opening,
    ) -> None:  # fmt: skip
        self.arm = arm
        self.fixture = fixture
        self.poses = poses
        self._solution = solution
        self._checks = checks
        self._origin = origin
        self._made_utc = utc_now()
        self._facts: Facts = facts_of(solution, checks=checks)
        self._calibrated_arm: CalibratedArm = calibrated_arm(solution, arm._model)

    @property
    def accepted(self) -> bool:
        """Whether the parameters may be used, with or without warnings."""
        return self._solution.accepted

    @property
    def verdict(self) -> str:
        """``accepted``, ``accepted_with_warnings`` or ``not_accepted``."""
        return str(self.to_json()["verdict"])

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why the calibration is not accepted; empty if it is accepted."""
        return self._solution.reasons

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings with their remedies."""
        return tuple(n.sentence for n in self._solution.warnings)

    @property
    def values(self) -> Mapping[str, float]:
        """Identified parameters by name and unit: ``theta_off_1_deg``, ``a_0_mm``, ..."""
        return self._by_name(self._solution.identified.x)

    @property
    def sigmas(self) -> Mapping[str, float]:
        """Standard deviations of the values, from all stated sources of error, with the keys of `values`."""
        return self._by_name(self._solution.identified.standard_deviation)

    @property
    def intervals_95(self) -> Mapping[str, tuple[float, float]]:
        """95 % intervals of the values, lower and upper end, with the keys of `values`."""
        low, high = map(self._by_name, intervals(self._solution.identified))
        return MappingProxyType({name: (low[name], high[name]) for name in low})

    @property
    def corrections(self) -> tuple[Mapping[str, Any], ...]:
        """Corrections of the readings, as in `to_json`; `fk` adds them to the readings if ``corrections=True``."""
        return tuple(self.to_json()["corrections"])

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the available tables, the most important first."""
        return tuple(t.ident for t in self._facts.tables)

    def table(self, name: str = "parameters") -> Table:
        """Return the table with this name; if there is none, raises KeyError with the available names."""
        table = self._facts.table(name)
        if table is None:
            raise KeyError(f"no table {name!r}; there are {', '.join(self.tables)}")
        return Table(table.ident, table.title, table)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures that `figure` draws."""
        return tuple(drawings(self._subject))

    def figure(self, name: str = "parameters") -> PaperFigure:
        """Return one figure for a paper, as wide as one or two columns of a journal.

        A notebook shows the figure. ``figure("budget").savefig("budget.svg")`` writes a file. A ``.pdf`` needs the
        extra ``[plots]``. If there is no figure with this name, raises KeyError with the available names.
        """
        return draw_figure(self._subject, name)

    def to_json(self) -> dict[str, Any]:
        """Return the object of ``sarcal solve --json``: angles in deg, lengths in m unless the key has another unit."""
        return deepcopy(self._facts.json)

    @property
    def text(self) -> str:
        """Text that ``sarcal solve`` prints."""
        return facts_text(self._facts)

    def fk(
        self, q_rad: ArrayLike, *, frame: Frame = "tip", corrections: bool = False
    ) -> FloatArray:
        """Return the calibrated pose of the tool in the arm's base frame.

        By default, this uses the D-H table that gives the best tool positions from readings without corrections. The
        base frame is that of the arm file. Entries that describe the fixture on the ground (``side`` is ``ground`` in
        `to_json`), such as ``s_1`` with a hinge, do not move this frame. If the fixture was remounted, the tool is that
        of the last placement. If the readings of a joint were not used, the joint's offset is the mean, over the poses,
        of the angle in the closed loop minus the reading.

        Parameters
        ----------
        q_rad
            Sensor readings (n,) or (m, n), rad.
        frame
            ``tip``: the point of the tool at the fixture, with the orientation of the last D-H frame (with a hinge, z
            is along the hinge axis). ``flange``: frame n of the arm's own D-H table, as in an exported URDF; this pose
            is valid in any mounting.
        corrections
            Use the identified D-H table instead, and add `Result.corrections` to the readings. This is more accurate,
            but a controller then has to apply the corrections too.

        Returns
        -------
        T_base_tip or T_base_flange, (4, 4) or (m, 4, 4), lengths in m.

        Raises
        ------
        TypeError, ValueError
            The readings are not valid for this arm, or there is no such frame.
        """
        one_of("frame", frame, get_args(Frame))
        q = readings_rad(q_rad, self.arm._model)
        return self._calibrated_arm.T_base(q, frame, corrected=corrections)

    def tip_sigma(self, q_rad: ArrayLike) -> FloatArray:
        """Return the standard deviation of the tip position from `fk`, m: the root of the summed variances of x, y, z.

        This includes the covariance of the parameters. For a joint whose readings were not used in the calibration, the
        scatter of the readings about the angle in the closed loop is added. Other errors of readings are left out.

        Parameters
        ----------
        q_rad
            Sensor readings (n,) or (m, n), rad.

        Returns
        -------
        () or (m,), m.
        """
        q = readings_rad(q_rad, self.arm._model)
        if not q.size:
            return np.zeros(q.shape[:-1])
        _, sigma_m = self._calibrated_arm.tip_with_sigma_m(q.reshape(-1, q.shape[-1]))
        return sigma_m.reshape(q.shape[:-1])

    def save(self, folder: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write a session folder (journal, poses.csv, report.html, parameters.yaml) and return its path.

        ``sarcal report``, ``compare``, ``verify`` and ``export`` work on this folder. parameters.yaml is left out if
        the calibration was not accepted, or if a D-H table cannot describe the whole loop (e.g. with a ball).

        If the folder has a session of the same poses, arm and fixture, as when a notebook cell or script is run again,
        this session is replaced and its exports are removed. Other files remain.

        Parameters
        ----------
        folder
            A new folder, a folder without a session, or one with a session of the same poses, arm and fixture.
        overwrite
            Also replace a saved or imported session of other data. A session that was captured from an arm, or that
            has notes or excluded poses, is never replaced.

        Raises
        ------
        ValueError
            The name of the folder is empty.
        SessionError, WriteError
            The folder cannot be written, its session must not be replaced, or this result was read from a session.
        """
        if isinstance(self._origin, Opening):
            raise SessionError(
                f"this result was read from the session {self._origin.folder}",
                "copy that folder, or write single files with export",
            )
        if not fspath(folder):
            raise ValueError("folder is empty: give the name of a folder, or . for the current one")
        where, session = Path(folder), self._session(self._origin)
        session.write(
            folder=where,
            overwrite=overwrite,
            stale=(PARAMETERS_NAME, POSES_NAME, REPORT_NAME, *EXPORT_FILES.values()),
        )
        save_poses(where / POSES_NAME, session.state.pose_set())
        has_table = self._solution.model.dh_table(self._solution.estimate.x) is not None
        if self.accepted and has_table:
            document = parameters_document(self._solution, session.state, session.procedure)
            save_parameters(where / PARAMETERS_NAME, document)
        calibration = StoredCalibration(
            solution=self._solution, checks=self._checks, recalculated_because=""
        )
        subject = subject_of_session(where, read_journal(where), session.procedure, calibration)
        write_atomically(where / REPORT_NAME, report_html(subject))
        return where

    def export(
        self, path: str | PathLike[str], *, force: str = "", into: str | PathLike[str] | None = None
    ) -> Path:
        """Write one file for another tool, as ``sarcal export --format`` does, and return its path.

        Parameters
        ----------
        path
            Path whose ending selects the format: ``.yaml`` parameters file, ``.json`` everything, ``.csv`` one row per
            parameter, ``.urdf`` the arm without fixture, ``.mat`` MATLAB.
        force
            Reason, written into the file, for using a calibration that is not accepted; ignored if it is accepted.
        into
            Your own URDF, xacro with literal numbers, or UR ``default_kinematics.yaml``. A copy of this file is then
            written in which only the joint origins are changed, whatever the ending of `path`.

        Raises
        ------
        ValueError
            `path` has an unknown ending, or is the same file as `into`.
        ConfigError
            The file `into` cannot be read, or describes another arm.
        SessionError
            The calibration is not accepted and `force` gives no reason, or a parameters file was requested and a D-H
            table cannot describe the whole loop (e.g. with a ball).
        WriteError
            The file cannot be written.
        """
        if not isinstance(force, str):
            raise TypeError(f'force={force!r}: state the reason, as force="reason"')
        target = Path(path)
        kind = target.suffix.removeprefix(".")
        if into is None and kind not in (*YAML, *EXPORT_FILES):
            endings = ", .".join(("yaml", *EXPORT_FILES))
            raise ValueError(f"{target.name}: give a path that ends in .{endings}")
        forced = export_reason(self._solution, force, stated_by='force="why"')
        if into is None and kind in YAML:
            save_parameters(target, self._document(forced=forced))
            return target
        what = Calibration(
            solution=self._solution,
            checks=self._checks,
            arm=self.arm._model,
            serial_number=self._state_source.state.serial_number,
            poses=self.poses._set,
            forced=forced,
        )
        if into is None:
            data = in_format(what, kind)
        else:
            own = Path(into)
            if own.absolute() == target.absolute():
                raise ValueError(f"{target} is also the file of into=: give another path")
            read = read_limited(own, str(into), limit=DESCRIPTION_LIMIT_BYTES)
            data = into_description(what, read, own.name)
        write_atomically(target, data)
        return target

    def __repr__(self) -> str:
        return (
            f"<sarcal.Result {self._facts.verdict.lower()}: {self.arm.name} in {self.fixture.name}, "
            f"{self._solution.poses} poses, {len(self._solution.identified.parameters)} parameters>"
        )

    def _repr_html_(self) -> str:
        parts = [element("p", element("b", self._facts.verdict.capitalize()))]
        parts += [element("p", reason) for reason in self.reasons]
        parts += [element("p", h.text) for h in self._facts.headlines]
        parameters = self._facts.table("parameters")
        return str(join([*parts, *([] if parameters is None else [table_html(parameters)])]))

    @cached_property
    def _subject(self) -> Subject:
        source = self._state_source
        return Subject(
            name=source.procedure.name,
            procedure=source.procedure,
            state=source.state,
            solution=self._solution,
            checks=self._checks,
        )

    @cached_property
    def _state_source(self) -> Opening | ImportedSession:
        """The session from which the result was read, or else the session that `save` would write."""
        origin = self._origin
        return origin if isinstance(origin, Opening) else self._session(origin)

    def _time_of_calibration(self) -> datetime:
        return self._made_utc

    def _session(self, options: CalibrationOptions) -> ImportedSession:
        made = ImportedSession(
            self.poses._set,
            arm=self.arm._resource,
            fixture=self.fixture._resource,
            file=self.poses.source,
            name=f"{self.arm.name}-{self.fixture.name}",
            options=options,
            clock=self._time_of_calibration,
        )
        made.add(self._solution, self._checks)
        return made

    def _document(self, *, forced: str = "") -> ParametersDocument:
        source = self._state_source
        return parameters_document(self._solution, source.state, source.procedure, forced=forced)

    def _by_name(self, values: FloatArray) -> Mapping[str, float]:
        return with_units(self._solution.identified.parameters, values.tolist())
