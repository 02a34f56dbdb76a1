"""Predicts, from nominal geometry, the drive joints and the identifiability of an arm in a fixture."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fixtures.base import EndpointConstraint, SetupCheck, Severity
from fixtures.measured import Measured
from fixtures.setup_checks import setup_checks
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.instrument_registration import with_registered_instrument
from operator_app.config.fixture_file import FixtureSpec
from operator_app.errors import SessionError
from operator_app.planning.drives import DriveChoice, best_or_named_drives, predict_drives
from operator_app.planning.task import without_hidden
from solver.arrays import FloatArray, evenly
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import Parameter, nominal_vector
from solver.closing import close_loops
from solver.diagnostics.identifiability import Identifiability, identifiability
from solver.errors import UnidentifiableDirection
from solver.loops.closure import ClosureModel

SPREAD = 60
"""Number of poses, spread over the reachable region, from which the best possible identifiability is computed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feasibility:
    """Whether an arm can be calibrated in a fixture, and with which drive joints.

    `parameters`: unknowns of the calibration, without those that cannot be identified in the fixture's placement.
    `mobility`: number of drive joints; None if the drive joints cannot be ranked.
    `home_to_closed_rad` (n,): nearest closed pose minus home; None if there is no closed pose.
    `choice`: drive joints; None if no joints can drive the chain. The reason is then in `refusal`.
    `identifiability`: of `parameters`, from poses over the reachable region; None if drive joints cannot be ranked.
    For an open arm, only `parameters`, `checks` and `mobility` are given.
    """

    parameters: tuple[Parameter, ...]
    checks: tuple[SetupCheck, ...]
    mobility: int | None
    home_to_closed_rad: FloatArray | None = None
    choice: DriveChoice | None = None
    refusal: SessionError | None = None
    identifiability: Identifiability | None = None

    @property
    def unidentifiable(self) -> tuple[UnidentifiableDirection, ...]:
        """Parameter directions that no poses of this chain determine."""
        return () if self.identifiability is None else self.identifiability.directions

    @property
    def refused(self) -> bool:
        """Whether a calibration would fail: no drive joints, unidentifiable parameters, or a refused set-up check."""
        return (
            self.refusal is not None
            or bool(self.unidentifiable)
            or any(c.severity is Severity.REFUSED for c in self.checks)
        )


def assess_feasibility(
    arm: ArmModel,
    fixture: EndpointConstraint,
    *,
    position_joints: tuple[int, ...] | None = None,
    unsensed_joints: tuple[int, ...] = (),
) -> Feasibility:
    """Predict whether `arm` can be calibrated in `fixture`; `position_joints`: drive joints, None for the best."""
    unsensed = tuple(sorted({*unsensed_joints, *arm.unsensed_joints}))
    model = without_hidden(arm, fixture, fixture.model(arm, unsensed_joints=unsensed))
    parameters, checks = model.parameters, setup_checks(fixture, arm, arm.home_rad)
    if isinstance(fixture, Measured):
        return Feasibility(parameters=parameters, mobility=arm.joint_count, checks=checks)
    loop = fixture.model(arm)
    x = nominal_vector(loop.parameters)
    mobility, choice, refusal, identified = None, None, None, None
    try:
        prediction = predict_drives(arm, loop, x, arm.home_rad)
        mobility = prediction.manifold.motion.degrees
        q = prediction.manifold.q
        identified = _identifiability_at(model, q[evenly(len(q), SPREAD)])
        choice = best_or_named_drives(
            prediction, position_joints, kind=fixture.kind, unsensed_joints=unsensed
        )
    except SessionError as error:
        refusal = error
    return Feasibility(
        parameters=parameters,
        home_to_closed_rad=home_to_closed_rad(arm, fixture),
        mobility=mobility,
        checks=checks,
        choice=choice,
        refusal=refusal,
        identifiability=identified,
    )


def identifiability_of_poses(experiment: Experiment) -> Identifiability:
    """Return the identifiability from captured poses; raises `SolverError` if they do not fit the fixture."""
    arm, poses = experiment.arm, experiment.poses
    fixture = with_registered_instrument(arm, experiment.fixture, poses)
    unsensed = tuple(sorted({*experiment.unsensed, *arm.unsensed_joints}))
    model = replace(experiment, fixture=fixture, unsensed=unsensed).loop()
    return _identifiability_at(without_hidden(arm, fixture, model), poses.q_rad)


def _identifiability_at(model: ClosureModel, q_rad: FloatArray) -> Identifiability:
    return identifiability(model, nominal_vector(model.parameters), q_rad)


def home_to_closed_rad(arm: ArmModel, fixture: EndpointConstraint) -> FloatArray | None:
    """Return the closed pose nearest to the arm's home, minus home (n,), rad; None if no pose closes."""
    model = fixture.model(arm)
    home = close_loops(model, nominal_vector(model.parameters), arm.home_rad[None])
    return home.q[0] - arm.home_rad if home.closed[0] else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """An arm in a fixture, with the feasibility of its calibration.

    `procedure`: name of the procedure, or "". `held`: entries fixed at their value in the arm file, with the reasons.
    `home`: proposed home (n,), rad, with its `Feasibility`; None if the arm's own home is good, or no home was found.
    `poses`: names of the poses files for this arm and fixture, each with the identifiability from its poses.
    `unfit`: names of the poses files that do not fit this fixture, each with the reason.
    """

    arm: ArmModel
    fixture: FixtureSpec
    feasibility: Feasibility
    procedure: str
    held: Mapping[str, str]
    home: tuple[FloatArray, Feasibility] | None
    poses: tuple[tuple[str, Identifiability], ...]
    unfit: tuple[tuple[str, str], ...]

    @property
    def refused(self) -> bool:
        """Whether a calibration would fail, or any poses file either does not fit or leaves parameters undetermined."""
        unidentifiable = any(identified.directions for _, identified in self.poses)
        return self.feasibility.refused or unidentifiable or bool(self.unfit)
