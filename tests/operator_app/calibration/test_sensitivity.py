"""What would narrow a sigma: the source said to bring most of it, held against a calibration without it."""

from dataclasses import replace

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.sensitivity import WORST, source_sensitivities
from operator_app.messages.calibration import SOURCE_REMEDIES, source_remedy
from tests.oracles.as_shipped import ARM, HINGE, fit_of, poses_of
from tests.oracles.shop_floor import Sizes, session


def test_stiffer_fixture_narrows_sigmas_as_predicted(sound):
    said = source_sensitivities(sound)
    assert len(said) == WORST
    give = HINGE.compliance
    stiffer = replace(
        HINGE,
        compliance=replace(
            give, position_m=0.5 * give.position_m, orientation_rad=0.5 * give.orientation_rad
        ),
    )
    mounted = session(3001, Sizes(give_m=0.1e-3, give_rad=0.1e-3))
    half = calibrate(ARM, stiffer, poses_of(mounted)).estimate
    assert "fixture_give" in {h.source for h in said}
    for h in said:
        assert 0.5 * h.sigma <= h.then < h.sigma
        assert h.remedy
        if h.source == "fixture_give":
            assert half.sd_by_name[h.parameter.name] < 1.05 * h.then


def test_every_error_component_is_in_the_budget(sound):
    """Or a source that exceeds its specification would not be named as what widens a sigma."""
    found = fit_of(session(3001))
    sources = {c.source for c in found.linear.design.components} - {"discrepancy"}
    assert sources <= set(sound.components.budget)


def test_every_source_has_its_own_remedy():
    assert len({source_remedy(source) for source in SOURCE_REMEDIES}) == len(SOURCE_REMEDIES)


def test_a_joint_beyond_nine_keeps_its_number():
    assert "joint 10 " in source_remedy("rvdt_curve_10")
