"""Predicted narrowing of sigmas, against a calibration without the source."""

from dataclasses import replace

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.sensitivity import WORST, source_sensitivities
from solver.estimators.layout import UNMODELLED
from tests.oracles.as_shipped import ARM, HINGE, fit_of, poses_of
from tests.oracles.shop_floor import Sizes, session


def test_stiffer_fixture_narrows_sigmas_as_predicted(sound):
    sensitivities = source_sensitivities(sound)
    assert len(sensitivities) == WORST
    compliance = HINGE.compliance
    stiffer = replace(
        HINGE,
        compliance=replace(
            compliance,
            position_m=0.5 * compliance.position_m,
            orientation_rad=0.5 * compliance.orientation_rad,
        ),
    )
    taken = session(3001, Sizes(give_m=0.1e-3, give_rad=0.1e-3))
    stiff_estimate = calibrate(ARM, stiffer, poses_of(taken)).estimate
    assert "fixture_give" in {sensitivity.source for sensitivity in sensitivities}
    for sensitivity in sensitivities:
        assert 0.5 * sensitivity.sigma <= sensitivity.then < sensitivity.sigma
        assert sensitivity.remedy
        if sensitivity.source == "fixture_give":
            assert stiff_estimate.sd_by_name[sensitivity.parameter.name] < 1.05 * sensitivity.then


def test_every_error_component_is_in_the_budget(sound):
    fit = fit_of(session(3001))
    # What the models leave out is listed with the effects it belongs to.
    sources = {c.source for c in fit.linear.design.components} - {"discrepancy", UNMODELLED}
    assert sources <= set(sound.components.budget)
