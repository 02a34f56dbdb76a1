"""`sarcal run --plan planned` over the bus and `sarcal plan`, as a user meets them."""

import contextlib
import io
from pathlib import Path

import pytest
import yaml

from operator_app.cli import main
from operator_app.config.resources import resolve
from operator_app.session.store.journal import read_journal
from tests.oracles.own_process import finished, start
from tests.oracles.recorded import recorded

HINGE = {"theta_off_1": 9.9, "theta_off_5": 27.1, "a_0": 0.202, "alpha_7": 99.8}
"""Some of Table 2, deg and m."""


def planned_procedure(folder: Path, **capture: object) -> Path:
    """The packaged planned procedure with another capture section."""
    document = yaml.safe_load(resolve("procedure", "hinge_planned").data)
    document["capture"].update(capture)
    path = folder / "procedure.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def datasheet(tmp_path_factory):
    """A planned session on the data sheet's arm, in a process of its own."""
    folder = tmp_path_factory.mktemp("datasheet")
    done = finished(start(folder, "run", "hinge_planned", "--poses", "6", "--json"), 0)
    return folder / "sessions", done


@pytest.mark.campaign
def test_a_few_planned_poses_beat_the_packaged_forty_in_condition(datasheet):
    sessions, done = datasheet
    found = done.json
    assert found["capture"]["complete"]
    assert found["capture"]["planned"] == 6
    assert found["poses"] == found["capture"]["explored"] + 6 < 20
    assert found["scaled_condition_number"] < 25
    for name, value in HINGE.items():
        assert abs(found["parameters"][name] - value) < 6.0 * found["sigma"][name], name
    # Every decision is said while it is made.
    assert "Drive joints: 1 and 5 (reach" in done.err
    assert "Explored" in done.err
    assert "Capture complete: all 6 planned poses are taken." in done.err
    (folder,) = (p for p in sessions.iterdir() if not p.name.endswith("verify"))
    names = [e.name for e in read_journal(folder).events]
    assert {"drives_chosen", "campaign", "campaign_move", "campaign_ended"} <= set(names)


@pytest.mark.campaign
def test_plan_on_the_estimate_of_a_session(datasheet, ends_with):
    sessions, done = datasheet
    taken = done.json["poses"]
    options = ["--session", "latest", "--sessions", str(sessions), "--poses", "2", "--json"]
    found = ends_with(0, "plan", *options).json
    assert found["captured"] == taken
    assert f"estimate of {taken} poses" in found["basis"]
    assert len(found["poses"]) == 2
    # All poses together count, so that two more are not judged alone.
    assert found["scaled_condition_number"] < 25
    # Errors are as large as the captured poses show: two more poses forecast little less than the calibration states.
    for name, sigma in done.json["sigma"].items():
        assert 0.6 * sigma < found["sigma"][name] < 1.05 * sigma, name


@pytest.mark.campaign
def test_what_no_pose_brings_to_the_request_is_named_with_advice(tmp_path, ends_with):
    path = planned_procedure(tmp_path, poses=2, requested_sigma={"alpha_0_deg": 1e-9})
    out = ends_with(0, "run", path, "--scenario", "exact", "--sessions", tmp_path / "s").out
    plan = out[out.index("Plan        ") : out.index("Session     ")]
    words = " ".join(plan.split())
    assert "alpha_0" in words
    assert "short of the request" in words
    assert "placement" in words
    assert max(len(row) for row in plan.splitlines()) <= 80


@pytest.fixture(scope="module")
def plan_output():
    return printed_plans()


@recorded
def printed_plans() -> dict[str, str]:
    """What `sarcal plan` prints, in the two looks; the plain one with advice."""
    found = {}
    for look, extra in (("unicode", []), ("ascii", ["--ascii", "--advise", "--tries", "1"])):
        out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
        with contextlib.redirect_stdout(out):
            assert main(["plan", "hinge", "--poses", "6", *extra]) == 0
        found[look] = out.buffer.getvalue().decode()
    return found


@pytest.mark.parametrize("look", ["unicode", "ascii"])
def test_plan_has_its_poses_in_80_columns_without_colour(plan_output, look):
    text = plan_output[look]
    table = text[text.index("visiting order") :].splitlines()[3:9]
    assert [row.split()[0] for row in table] == list("123456")
    assert all(len(row.split()) == 10 for row in table)
    assert max(len(row) for row in text.splitlines()) <= 80
    assert "\x1b" not in text


def test_plain_ascii_on_request(plan_output):
    assert any("\u2800" < c <= "\u28ff" for c in plan_output["unicode"])
    assert plan_output["ascii"].isascii()
    picture = plan_output["ascii"].split("Path of the drive joints")[1].split("Ranges")[0]
    for label in ("S", "1", "6", "*", "J1 deg", "J5 deg"):
        assert label in picture
    advice = plan_output["ascii"].split("Hinge placements")[1]
    for word in ("as it is", "mobility", "condition", "joint ranges reached: J1", "sigmas in mm"):
        assert word in advice


@pytest.mark.campaign
def test_plan_as_json_with_advice(ends_with):
    few = ["--poses", "4", "--tries", "1"]
    found = ends_with(0, "plan", "hinge_planned", *few, "--advise", "--json").json
    assert found["basis"] == "nominal geometry"
    assert found["mobility"] == 2
    assert found["drives"]["joints"] == [1, 5]
    assert len(found["drives"]["over_region"]) == 21
    assert [pose["number"] for pose in found["poses"]] == [1, 2, 3, 4]
    first = found["poses"][0]
    for joint, target in first["targets_deg"].items():
        assert target == first["predicted_deg"][int(joint) - 1]
    assert len(found["sigma"]) == 14
    assert 1.0 < found["scaled_condition_number"] < 50.0
    assert found["advice"]
    best = found["advice"][0]
    assert best["mobility"] == 2
    assert len(best["reach_deg"]) == 7
    assert set(best["sigma"]) == set(found["sigma"])
    assert [p["gain"] for p in found["advice"]] == sorted(p["gain"] for p in found["advice"])


def test_joints_that_are_not_used_drop_out_of_the_plan(ends_with):
    words = ["plan", "hinge", "--poses", "4", "--unsensed", "6,7", "--json"]
    assert set(ends_with(0, *words).json["sigma"]).isdisjoint({"theta_off_6", "theta_off_7"})


@pytest.mark.campaign
def test_rigid_is_planned_with_its_elbow_held_and_says_why(ends_with):
    said = ends_with(0, "plan", "rigid", "--poses", "4").words
    assert "theta_off_4 is fixed at" in said
    assert "1 mm of length would pass for an offset" in said


@pytest.mark.campaign
def test_the_drives_of_a_foreign_arm_are_ranked_and_not_those_of_another(
    ends_with, tmp_path, monkeypatch
):
    """Joints 1 and 5 are the packaged arm's in its hinge; here one of another arm drives."""
    monkeypatch.chdir(tmp_path)
    arm = yaml.safe_load(resolve("arm", "sarcos_dextrous").data)
    arm |= {"name": "mine", "free": [f for f in arm["free"] if f != "theta_off_4"]}
    arm["home_deg"] = yaml.safe_load(resolve("procedure", "rigid").data)["home_deg"]
    Path("mine.yaml").write_text(yaml.safe_dump(arm, sort_keys=False))
    for procedure in ([], ["hinge"]):
        options = ["--arm", "mine.yaml", "--fixture", "rigid", "--poses", "2", "--json"]
        drives = ends_with(0, "plan", *procedure, *options).json["drives"]
        assert drives["joints"] == [2]
        assert drives["reasons"][0].startswith("reaches ")
