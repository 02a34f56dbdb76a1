"""`plan` chooses the most informative poses before the arm moves; `simulate` returns simulated poses for tests."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike

import numpy as np

from operator_app.planning.preview import Preview, preview
from operator_app.planning.simulated import simulated_poses
from operator_app.report.results.plan import plan_json, plan_text
from solver.arrays import FloatArray

from .calls import WholeNumbers, joints, one_blas_thread, whole
from .machines import Arm, Fixture, load_arm, load_fixture
from .poses import Poses
from .tables import with_units


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Planned poses in visiting order, with the predicted sigmas; made by `plan`."""

    _shown: Preview = field(repr=False)
    _title: str = field(repr=False)

    @property
    def drive_joints(self) -> tuple[int, ...]:
        """Joints (from 1) in position mode; the others are free."""
        return self._shown.choice.drives

    @property
    def q_rad(self) -> FloatArray:
        """Predicted sensor readings of the planned poses, (m, n), rad."""
        return np.array([p.q_rad for p in self._shown.poses])

    @property
    def sigmas(self) -> Mapping[str, float]:
        """Predicted standard deviations, with keys as in `Result.sigmas`, if errors are as large as the files state."""
        parameters, sigmas = zip(*self._shown.predicted_sigma, strict=True)
        return with_units(parameters, sigmas)

    @property
    def scaled_condition_number(self) -> float:
        """Scaled condition number of the reduced Jacobian at the planned poses."""
        return self._shown.identifiability.scaled_condition_number

    def to_json(self) -> dict[str, object]:
        """Return the object of ``sarcal plan --json``."""
        return dict(plan_json(self._shown, basis="nominal geometry"))

    def __str__(self) -> str:
        return plan_text(self._shown, title=self._title, ascii_only=False)

    def __repr__(self) -> str:
        drives = ", ".join(map(str, self.drive_joints))
        return f"<sarcal.Plan: {len(self._shown.poses)} poses, drive joints {drives}>"


@one_blas_thread
def plan(
    *,
    arm: str | PathLike[str] | Arm,
    fixture: str | PathLike[str] | Fixture,
    poses: int = 12,
    drive_joints: WholeNumbers | None = None,
    unsensed_joints: WholeNumbers = (),
    samples: int = 32,
    seed: int = 0,
) -> Plan:
    """Choose drive joints and the most informative poses, from nominal geometry, as ``sarcal plan`` does.

    ``sarcal plan`` uses the seed of its procedure (1 in the built-in ``hinge``); the default here is 0.

    Parameters
    ----------
    arm, fixture
        As for `load_arm` and `load_fixture`.
    poses
        Number of poses.
    drive_joints
        Joints (from 1) in position mode; None: the best set is chosen.
    unsensed_joints
        Joints whose readings will not be used.
    samples
        Readings averaged into one pose.
    seed
        Seed of the candidate poses.

    Raises
    ------
    TypeError, ValueError
        An argument is invalid; the text names it.
    SessionError
        No plan can be made; the text gives the reason and the remedy.

    Examples
    --------
    >>> import sarcal
    >>> planned = sarcal.plan(arm="sarcos_dextrous", fixture="hinge", drive_joints=[1, 5])
    >>> planned
    <sarcal.Plan: 12 poses, drive joints 1, 5>
    >>> planned.q_rad.shape
    (12, 7)
    """
    loaded_arm, loaded_fixture = load_arm(arm), load_fixture(fixture)
    shown = preview(
        loaded_arm._model,
        loaded_fixture._spec.fixture,
        poses=whole("poses", poses, least=1),
        position_joints=None
        if drive_joints is None
        else joints("drive_joints", drive_joints, loaded_arm.joint_count),
        unsensed_joints=joints("unsensed_joints", unsensed_joints, loaded_arm.joint_count),
        samples=whole("samples", samples, least=1),
        seed=whole("seed", seed),
    )
    names = f"{loaded_arm.name} in fixture {loaded_fixture.name}"
    return Plan(shown, f"Plan: {names}, from nominal geometry")


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Simulated readings and the true parameters; made by `simulate`.

    Attributes
    ----------
    poses
        The readings.
    truth
        True values, with keys as in `Result.values`.
    """

    poses: Poses
    truth: Mapping[str, float] = field(repr=False)


@one_blas_thread
def simulate(
    *,
    arm: str | PathLike[str] | Arm,
    fixture: str | PathLike[str] | Fixture,
    poses: int = 40,
    samples: int = 32,
    seed: int = 0,
) -> Simulation:
    """Draw the true parameters of an arm and its mounting at random, and return simulated readings.

    Offsets, lengths and twists have the tolerances in the arm file as standard deviations. Without a tolerance, offsets
    have 2 deg. The placement deviates by at most half its stated tolerance. Sensors have their stated resolution and
    noise. RVDTs also have the largest linearity deviation within specification. Encoder scale errors, backlash, sag and
    compliance are not included, but ``sarcal run`` simulates them.

    Parameters
    ----------
    arm, fixture
        As for `load_arm` and `load_fixture`.
    poses
        Number of poses.
    samples
        Readings averaged into one pose.
    seed
        The same seed gives the same arm and the same readings.

    Raises
    ------
    TypeError, ValueError
        An argument is invalid; the text names it.
    SessionError
        The chain is open, or the loop does not close in that many poses near the arm's home pose.

    Examples
    --------
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=20, seed=3)
    >>> made.poses
    <sarcal.Poses: 20 poses of 7 joints>
    >>> "s_1_mm" in made.truth
    True
    """
    loaded_arm, loaded_fixture = load_arm(arm), load_fixture(fixture)
    made = simulated_poses(
        loaded_arm._model,
        loaded_fixture._spec,
        poses=whole("poses", poses, least=1),
        samples=whole("samples", samples, least=1),
        seed=whole("seed", seed),
    )
    truth = with_units(made.parameters, made.x.tolist())
    return Simulation(Poses(f"simulated, seed {seed}", made.poses), truth)
