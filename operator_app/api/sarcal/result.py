"""What a calibration gives a program: values with units, tables, the hand, files. Computes nothing itself."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from operator_app.calibration.calibrated_arm import CalibratedArm, calibrated_arm
from operator_app.calibration.checks import Checks
from operator_app.calibration.solution import Solution
from operator_app.config.atomic import write_atomically
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import save_parameters
from operator_app.config.poses_file import save_poses
from operator_app.report.exports import FILES, Calibration, in_format
from operator_app.report.facts import Facts, facts_of
from operator_app.report.html import report_html
from operator_app.report.markup import element, join
from operator_app.report.of_session import REPORT_NAME
from operator_app.report.page_table import table_html
from operator_app.report.paper_figures import drawings
from operator_app.report.plotted import figure as draw_figure
from operator_app.report.subject import Subject, subject_of_session
from operator_app.report.text import facts_text
from operator_app.session.calibrated import Calibrated
from operator_app.session.export import PARAMETERS_NAME, POSES_NAME, document_of
from operator_app.session.importing import UNSTATED, How, ImportedSession
from operator_app.session.journal import read_journal
from solver.arrays import FloatArray

from .machines import Arm, Fixture
from .naming import with_units
from .poses import Poses
from .tables import Table


class Result:
    """A calibration, made by `calibrate`.

    Attributes
    ----------
    arm, fixture, poses
        What it was made of.

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
    >>> bool((sigma_m < 0.002).all())
    True
    """

    def __init__(
        self, *, arm: Arm, fixture: Fixture, poses: Poses, solution: Solution, checks: Checks | None,
        how: How,
    ) -> None:  # fmt: skip
        self.arm = arm
        self.fixture = fixture
        self.poses = poses
        self._solution = solution
        self._checks = checks
        self._how = how
        self._facts: Facts = facts_of(solution, checks=checks)
        self._hand: CalibratedArm = calibrated_arm(solution, arm._model)

    # -- what it says ------------------------------------------------------------------------------

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
        """Why it is not accepted; empty when it is."""
        return self._solution.reasons

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the operator should know and do."""
        return tuple(n.text for n in self._solution.warnings)

    @property
    def values(self) -> Mapping[str, float]:
        """Identified parameters by name and unit: ``theta_off_1_deg``, ``a_0_mm``, ..."""
        return self._by_name(self._solution.identified.x)

    @property
    def sigmas(self) -> Mapping[str, float]:
        """Their standard deviations, in which every stated source of error is, by the same names."""
        return self._by_name(self._solution.identified.standard_deviation)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables that there are, the most important first."""
        return tuple(t.ident for t in self._facts.tables)

    def table(self, name: str = "parameters") -> Table:
        """Return one table; KeyError lists the names when there is none of that name."""
        found = self._facts.table(name)
        if found is None:
            raise KeyError(f"no table {name!r}; there are {', '.join(self.tables)}")
        return Table(found.ident, found.title, found)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures that `figure` draws."""
        return tuple(drawings(self._subject))

    def figure(self, name: str = "parameters") -> Any:
        """Return one figure for a paper, a ``matplotlib.figure.Figure``; needs the extra ``[plots]``.

        A notebook shows it; ``figure("budget").savefig("budget.pdf")`` keeps it. Widths are those of one
        or two columns of a journal.

        Raises
        ------
        KeyError
            There is none of that name; lists those there are.
        SessionError
            matplotlib is not installed.
        """
        return draw_figure(self._subject, name)

    def to_json(self) -> dict[str, Any]:
        """Return the object of ``sarcal solve --json``: deg and m, as its keys say."""
        return self._facts.json

    @property
    def text(self) -> str:
        """What ``sarcal solve`` prints."""
        return facts_text(self._facts)

    # -- where the hand is -------------------------------------------------------------------------

    def fk(self, q_rad: ArrayLike, *, frame: Literal["tip", "flange"] = "tip") -> FloatArray:
        """Place of the hand in the arm's base frame, by the calibrated parameters.

        Parameters
        ----------
        q_rad
            Sensor readings (n,) or (m, n), rad.
        frame
            ``tip``: the point of the hand that the fixture held (a hinge's axis is z there);
            ``flange``: frame n of the arm's own D-H table, which outlives the mounting, as in an
            exported URDF.

        Returns
        -------
        T_base_tip (4, 4) or (m, 4, 4), lengths in m.
        """
        return self._hand.T_base(np.asarray(q_rad, dtype=np.float64), frame)

    def tip_sigma(self, q_rad: ArrayLike) -> FloatArray:
        """Standard deviation of the tip's distance from where `fk` says it is, in m.

        By the covariance of the parameters, as the arm's base sees the hand; errors of the readings come
        on top.

        Parameters
        ----------
        q_rad
            Sensor readings (n,) or (m, n), rad.

        Returns
        -------
        () or (m,), m.
        """
        q = np.asarray(q_rad, dtype=np.float64)
        return self._hand.tip_sigma_m(q.reshape(-1, q.shape[-1])).reshape(q.shape[:-1])

    # -- files -------------------------------------------------------------------------------------

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write a session folder: journal, poses.csv, report.html, and parameters.yaml if there are any.

        ``sarcal report``, ``compare``, ``verify`` and ``export`` work on it. `parameters.yaml` is left out
        where the calibration was not accepted, or has no D-H table of the whole loop (a ball).

        Parameters
        ----------
        folder
            A new one, or one that holds no session yet.

        Raises
        ------
        SessionError, WriteError
            There is a session already, or it cannot be written.
        """
        where, session = Path(folder), self._session()
        session.write(folder=where)
        save_poses(where / POSES_NAME, session.state.pose_set())
        if self.accepted and self._has_table:
            save_parameters(where / PARAMETERS_NAME, self._document(session))
        found = Calibrated(solution=self._solution, checks=self._checks, solved_again="")
        subject = subject_of_session(
            where.resolve().name, read_journal(where).events, session.procedure, found
        )
        write_atomically(where / REPORT_NAME, report_html(subject))
        return where

    def export(self, path: str | PathLike[str]) -> Path:
        """Write one file for another tool, as ``sarcal export --format`` does.

        Parameters
        ----------
        path
            Its ending says what: ``.yaml`` the parameters file, ``.json`` everything, ``.csv`` one row a
            parameter, ``.urdf`` the arm's own side, ``.mat`` MATLAB.

        Raises
        ------
        ValueError
            It has another ending.
        SessionError
            A parameters file of a calibration that has no D-H table of the whole loop (a ball).
        """
        target = Path(path)
        kind = target.suffix.removeprefix(".")
        if kind in ("yaml", "yml"):
            save_parameters(target, self._document())
            return target
        if kind not in FILES:
            raise ValueError(f"{target.name}: end in .yaml, .{', .'.join(FILES)}")
        what = Calibration(
            solution=self._solution,
            checks=self._checks,
            arm=self.arm._model,
            serial_number=UNSTATED,
            poses=self.poses._set,
            forced="" if self.accepted else "exported by a program",
        )
        write_atomically(target, in_format(what, kind))
        return target

    def __repr__(self) -> str:
        return (
            f"<sarcal.Result {self._facts.verdict.lower()}: {self.arm.name} in {self.fixture.name}, "
            f"{self._solution.poses} poses, {len(self._solution.identified.parameters)} parameters>"
        )

    def _repr_html_(self) -> str:
        said = [element("p", element("b", self._facts.verdict.capitalize()))]
        said += [element("p", reason) for reason in self.reasons]
        said += [element("p", h.text) for h in self._facts.headlines]
        parameters = self._facts.table("parameters")
        return str(join([*said, *([] if parameters is None else [table_html(parameters)])]))

    # -- inside ------------------------------------------------------------------------------------

    @property
    def _has_table(self) -> bool:
        return self._solution.model.dh_table(self._solution.estimate.x) is not None

    @cached_property
    def _subject(self) -> Subject:
        session = self._session()
        return Subject(
            name=session.procedure.name,
            procedure=session.procedure,
            state=session.state,
            solution=self._solution,
            checks=self._checks,
        )

    def _session(self) -> ImportedSession:
        made = ImportedSession(
            self.poses._set,
            arm=self.arm._resource,
            fixture=self.fixture._resource,
            file=self.poses.source,
            name=f"{self.arm.name}-{self.fixture.name}",
            how=self._how,
        )
        made.add(self._solution, self._checks)
        return made

    def _document(self, session: ImportedSession | None = None) -> ParametersDocument:
        session = self._session() if session is None else session
        return document_of(self._solution, session.state, session.procedure, utc=datetime.now(UTC))

    def _by_name(self, values: FloatArray) -> Mapping[str, float]:
        return with_units(self._solution.identified.parameters, values.tolist())
