"""Procedure files: packaged procedures fit their arms; references and joints are checked with lines."""

import math

import pytest

from operator_app.config.errors import ConfigError
from operator_app.config.procedure_file import load_procedure, parse_procedure
from operator_app.config.resources import Resource, resolve
from tests.oracles.mistakes import named, single_problem

GOOD = resolve("procedure", "hinge").data.decode()


def parse(text, folder=None):  # type: ignore[no-untyped-def]
    return parse_procedure(Resource(file="p.yaml", folder=folder, data=text.encode()))


def without_exploration(text, replacement=""):
    start, end = text.index("  exploration"), text.index("  speed_deg_per_s")
    return text[:start] + replacement + text[end:]


def test_settle_limits_follow_from_the_sensors():
    procedure = load_procedure("hinge")
    spread = procedure.capture.settle.spread_rad(procedure.arm)
    count = 2.0 * math.pi / 400000
    lsb = math.radians(120.0) / 4096
    assert spread[:5] == pytest.approx([8.0 * count / math.sqrt(12.0)] * 5, abs=math.radians(0.002))
    assert spread[5:] == pytest.approx([8.0 * lsb * math.sqrt(4.0 + 1.0 / 12.0)] * 2, rel=1e-12)


def test_automatic_modes_or_a_plan_need_no_exploration():
    text = GOOD.replace("modes: {position: [1, 5]}", "modes: auto")
    procedure = parse(without_exploration(text))
    assert procedure.position_joints is None
    assert procedure.capture.exploration == ()
    too_fast = text.replace("speed_deg_per_s: 20", "speed_deg_per_s: 200")
    with pytest.raises(ConfigError, match="exceeds the limit of joint"):
        parse(without_exploration(too_fast))
    assert parse(without_exploration(GOOD, "  plan: planned\n")).position_joints == (1, 5)


def test_trial_and_requested_sigma_are_read_in_si():
    text = GOOD.replace("modes: {position: [1, 5]}", "modes: {position: auto, trial: true}")
    options = "  plan: planned\n  requested_sigma: {theta_off_2_deg: 0.9, a_0_mm: 2}\n"
    procedure = parse(without_exploration(text, options))
    assert procedure.trial
    assert procedure.position_joints is None
    assert procedure.capture.strategy == "planned"
    assert procedure.capture.requested == pytest.approx(
        {"theta_off_2": math.radians(0.9), "a_0": 0.002}
    )


def test_relative_paths_start_at_the_procedure_folder(tmp_path):
    arm = resolve("arm", "sarcos_dextrous").data.decode()
    (tmp_path / "my_arm.yaml").write_text(arm.replace("name: sarcos_dextrous", "name: mine"))
    (tmp_path / "p.yaml").write_text(GOOD.replace("arm: sarcos_dextrous", "arm: my_arm.yaml"))
    procedure = load_procedure(tmp_path / "p.yaml")
    assert procedure.arm.name == "mine"
    assert procedure.sources[1].file == str(tmp_path / "my_arm.yaml")


def test_problems_of_arm_and_fixture_are_reported_together(tmp_path):
    (tmp_path / "arm.yaml").write_text("schema: sarcal/arm/1\nname: a\n")
    text = GOOD.replace("arm: sarcos_dextrous", "arm: arm.yaml").replace(
        "fixture: hinge", "fixture: hing"
    )
    with pytest.raises(ConfigError) as caught:
        parse(text, tmp_path)
    files_with_problems = {problem.file for problem in caught.value.problems}
    assert files_with_problems == {"p.yaml", str(tmp_path / "arm.yaml")}
    (fixture_problem,) = (p for p in caught.value.problems if p.file == "p.yaml")
    assert (fixture_problem.key, fixture_problem.line) == ("fixture", 4)
    assert "did you mean hinge?" in fixture_problem.remedy


BAD = [
    ("poses: 40", "poses: 0", "capture.poses"),
    ("poses: 40", "pose: 40", "capture.pose"),
    ("poses: 40", "poses: forty", "capture.poses"),
    ("speed_deg_per_s: 20", "speed_rad_per_s: 0.3", "capture.speed_rad_per_s"),
    ("speed_deg_per_s: 20", "speed_deg_per_s: 200", "capture.speed_deg_per_s"),
    ("modes: {position: [1, 5]}", "modes: atuo", "modes"),
    ("modes: {position: [1, 5]}", "modes: {positions: [1, 5]}", "modes.positions"),
    ("modes: {position: [1, 5]}", "modes: {position: [1, five]}", "modes.position[2]"),
    ("modes: {position: [1, 5]}", "modes: {position: [1, 5, 9]}", "modes.position[3]"),
    ("modes: {position: [1, 5]}", "modes: {position: [1, 5, 5]}", "modes.position[3]"),
    ("modes: {position: [1, 5]}", "modes: {position: [1]}", "capture.exploration[joint 5].joint"),
    ("    - {joint: 5, from_deg: -70, to_deg: 0}\n", "", "capture.exploration"),
    ("to_deg: 48", "to_deg: 80", "capture.exploration[joint 1].to_deg"),
    ("from_deg: -30", "from_deg: 30", "capture.exploration[joint 1].from_deg"),
    ("from_deg: -70, to_deg: 0", "from_deg: -0.5, to_deg: 0", "capture.exploration[joint 5].to_deg"),
    ("timeout_syncs: 1000", "timeout_syncs: 10", "capture.settle.timeout_syncs"),
    ("estimator: implicit", "estimator: implict", "estimator"),
    ("upload: true", "upload: yes", "export.upload"),
    ("scaled_condition_number: 100", "scaled_condition_number: 0.5",
     "acceptance.scaled_condition_number"),
    ("interface: virtual", "interface: virtual, bitrate: 5", "bus.bitrate"),
    ("arm: sarcos_dextrous", "arm: sarcos", "arm"),
    ("arm: sarcos_dextrous", "arm: ./sarcos.yaml", "arm"),
    ("estimator: implicit", "estimator: implicit\nunsensed_joints: [5]", "modes.position[2]"),
    ("estimator: implicit", "estimator: implicit\nunsensed_joints: [8]", "unsensed_joints[1]"),
    ("poses: 40", "plan: plannd\n  poses: 40", "capture.plan"),
    ("poses: 40", "poses: 40\n  requested_sigma: {a_0_mm: 0.1}", "capture.requested_sigma"),
    *(("poses: 40", f"poses: 40\n  plan: planned\n  requested_sigma: {{{name}: {sigma}}}",
       f"capture.requested_sigma.{name}")
      for name, sigma in (("a_0_m", 0.1), ("theta_off_1", 0.1), ("speed", 0.1), ("a_0_mm", 0))),
    ("modes: {position: [1, 5]}", "modes: {position: [1, 5], trial: true}", "modes.trial"),
    ("modes: {position: [1, 5]}", "modes: {position: [1, 5], trail: true}", "modes.trail"),
    ("modes: {position: [1, 5]}", "modes: {position: atuo}", "modes.position"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "key"), BAD, ids=named(BAD))
def test_one_mistake_gives_one_problem(old, new, key, approve):
    problem = single_problem(parse, GOOD, old, new)
    assert problem.key == key
    approve(str(problem))
