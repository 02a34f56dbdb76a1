"""What would narrow a sigma: the source said to bring most of it, held against a calibration without it."""

from dataclasses import replace

from fixtures.hinge import Hinge
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.sensitivity import WORST, source_sensitivities
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from operator_app.messages.calibration import SOURCE_REMEDIES, source_remedy
from tests.oracles.shop_floor import Sizes, session


def test_a_fixture_twice_as_stiff_brings_at_least_what_is_said() -> None:
    poses = parse_poses(session(3001).csv().encode(), "poses.csv").poses
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    assert isinstance(hinge, Hinge)
    found = calibrate(arm, hinge, poses)
    said = source_sensitivities(found)
    assert len(said) == WORST
    give = hinge.compliance
    stiffer = replace(
        hinge,
        compliance=replace(
            give, position_m=0.5 * give.position_m, orientation_rad=0.5 * give.orientation_rad
        ),
    )
    mounted = session(3001, Sizes(give_m=0.1e-3, give_rad=0.1e-3))
    half = calibrate(arm, stiffer, parse_poses(mounted.csv().encode(), "poses.csv").poses)
    sigma = dict(
        zip(
            (p.name for p in half.estimate.parameters),
            half.estimate.standard_deviation,
            strict=True,
        )
    )
    assert "fixture_give" in {h.source for h in said}
    for h in said:
        assert 0.5 * h.sigma <= h.then < h.sigma
        assert h.remedy
        if h.source == "fixture_give":
            assert sigma[h.parameter.name] < 1.05 * h.then


def test_every_source_has_a_remedy_of_its_own() -> None:
    assert len({source_remedy(source) for source in SOURCE_REMEDIES}) == len(SOURCE_REMEDIES)


def test_a_joint_beyond_nine_keeps_its_number() -> None:
    assert "joint 10 " in source_remedy("rvdt_curve_10")
