"""Makes the planning task of an arm in a fixture: ranges with margin, noise, drive sets, fixed parameters."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fixtures.base import CheckKind, EndpointConstraint, SetupCheck, Severity
from fixtures.measured import Measured
from fixtures.setup_checks import setup_checks
from operator_app.calibration.error_model import error_model, free_within_tolerance, stated_priors
from operator_app.calibration.experiment import Experiment
from operator_app.config.procedure import Procedure
from operator_app.errors import SessionError
from operator_app.units import MOUNTED_LENGTH, NOMINAL_OFFSET
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, nominal_vector
from solver.chain.poses import PoseSet
from solver.design.motion import Ranges
from solver.design.plan import CANDIDATES, PlanningTask
from solver.estimators.error_model import ErrorModel, variance_of_means
from solver.estimators.implicit import NoiseModel
from solver.loops.closure import ClosureModel

MARGIN_RAD = float(np.deg2rad(3.0))
"""Margin of planned poses to the ends of the joint ranges, in addition to the linearity deviation."""

CURVE_SHARE = 0.5
"""Share of a sensor's specified linearity deviation that interim estimates treat as noise."""
UNSENSED_SIGMA_RAD = 1.0
"""Standard deviation of a reading that is not used: so large that it carries no information."""


def ranges_of(arm: ArmModel) -> Ranges:
    """Return the ranges of all joints in sensor coordinates."""
    return Ranges(lower_rad=arm.lower_rad, upper_rad=arm.upper_rad)


def margin_rad(arm: ArmModel) -> FloatArray:
    """Return the margin (n,), rad, of planned poses from the range ends: `MARGIN_RAD` plus the linearity deviation."""
    return MARGIN_RAD + arm.linearity_rad()


def require_closed_chain(fixture: EndpointConstraint) -> None:
    """Raise `SessionError` if `fixture` is an instrument, which leaves the chain open."""
    if isinstance(fixture, Measured):
        raise SessionError(
            "planned poses need a closed chain, which an instrument does not provide",
            "use a fixture, or capture explored poses (plan: explore)",
        )


def without_hidden(arm: ArmModel, fixture: EndpointConstraint, model: ClosureModel) -> ClosureModel:
    """Return `model` in which unknowns that poses cannot distinguish from the placement are fixed at nominal values."""
    part, *_ = model.parts()[0]
    nominal = nominal_vector(part.parameters)
    checks = fixture.placement_checks(arm, part, nominal)
    hidden = {check.entry for check in checks if check.kind is CheckKind.HIDDEN}
    return model.without([p.name for p in model.parameters if p.name in hidden])


def planning_task(
    arm: ArmModel,
    fixture: EndpointConstraint,
    *,
    drive_sets: tuple[tuple[int, ...], ...] | None = None,
    unsensed_joints: tuple[int, ...] = (),
    samples: int = 1,
    seed: int = 0,
    candidates: int = CANDIDATES,
) -> PlanningTask:
    """Return the task of planning poses of `arm` in `fixture`.

    `drive_sets`: sets of drive joints, the current one first; None: rank all sets. `unsensed_joints`: joints whose
    readings are not used. `samples`: readings averaged into one pose. Raises `SessionError` for an open chain.
    """
    require_closed_chain(fixture)
    model = without_hidden(arm, fixture, fixture.model(arm))
    _, tolerance = free_within_tolerance(model, arm)
    lost, blind = {f"theta_off_{j}" for j in unsensed_joints}, [j - 1 for j in unsensed_joints]
    (of_reading,) = variance_of_means(arm, np.array([samples]))
    variance = (CURVE_SHARE * arm.linearity_rad()) ** 2 + of_reading
    variance[blind] = UNSENSED_SIGMA_RAD**2

    def errors_at(q_rad: FloatArray) -> ErrorModel:
        """Return the errors that the files state for m poses; `q_rad` (m, n) are means of `samples` readings."""
        m = len(q_rad)
        poses = PoseSet(
            placement=np.ones(m, dtype=np.int64),
            label=tuple(map(str, range(m))),
            q_rad=q_rad,
            samples=np.full(m, samples),
        )
        near = Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=unsensed_joints)
        errors = error_model(near, tolerance=tolerance)
        by_pose = errors.joint_variance.copy()
        by_pose[:, blind] = UNSENSED_SIGMA_RAD**2
        return replace(errors, joint_variance=by_pose)

    return PlanningTask(
        model=model,
        ranges=ranges_of(arm),
        margin_rad=margin_rad(arm),
        noise=NoiseModel(joint_variance=variance),
        errors_at=errors_at,
        toleranced=tuple(DhEntry.parse(name) for name in tolerance),
        prior=stated_priors(model, arm, fixture),
        parameters=tuple(p.name for p in model.parameters if p.name not in lost),
        drive_sets=drive_sets,
        candidates=candidates,
        seed=seed,
    )


def fixed_parameter_checks(procedure: Procedure) -> tuple[SetupCheck, ...]:
    """Return a set-up check for each entry that the procedure fixes, with the reason why it is fixed."""
    stacked = procedure.arm.table.stacked()
    checks = []
    for name, reason in procedure.held.items():
        entry = DhEntry.parse(name)
        value = float(stacked[entry.kind, entry.row - 1])
        shown = (NOMINAL_OFFSET if entry.kind.is_angle else MOUNTED_LENGTH)(value).with_unit
        checks.append(
            SetupCheck(
                kind=CheckKind.FIXED,
                entry=name,
                severity=Severity.OK,
                text=f"{name} is fixed at {shown}, its value in the arm file: {reason}",
            )
        )
    return tuple(checks)


def entries_to_fix(arm: ArmModel, fixture: EndpointConstraint) -> Mapping[str, str]:
    """Return the arm's D-H entries that must be fixed because poses in `fixture` cannot identify them, with reasons."""
    return {
        check.entry or f"theta_off_{check.joint}": check.text
        for check in setup_checks(fixture, arm, arm.home_rad)
        if check.kind in (CheckKind.HIDDEN, CheckKind.IMMOBILE)
    }
