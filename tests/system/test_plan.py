"""`sarcal run --plan planned` over the bus and `sarcal plan`, as commands."""

import contextlib
import io
import re
from importlib import resources
from pathlib import Path

import pytest
import yaml

from operator_app.cli import main
from operator_app.config.resources import resolve
from operator_app.session.store.journal import read_journal
from tests.oracles.own_process import finished, start
from tests.oracles.recorded import recorded

NUMBER = re.compile(r"(?<![\w`])\d+(?:\.\d+)?")
TRUE_VALUES = {"theta_off_1": 9.9, "theta_off_5": 27.1, "a_0": 0.202, "alpha_7": 99.8}
"""From Table 2, deg and m."""


@pytest.fixture(scope="module")
def planned_run(tmp_path_factory):
    """Session folder and answer of a planned run on the arm of the data sheet."""
    root = tmp_path_factory.mktemp("datasheet")
    answer = finished(start(root, "run", "hinge_planned", "--poses", "6", "--json"), 0)
    return root / answer.json["session"]["folder"], answer


@pytest.mark.campaign
def test_six_planned_poses_have_a_lower_condition_number_than_forty(planned_run):
    folder, answer = planned_run
    result = answer.json
    assert result["capture"]["complete"]
    assert result["capture"]["planned"] == 6
    assert result["poses"] == result["capture"]["explored"] + 6 < 20
    assert result["scaled_condition_number"] < 25
    for name, value in TRUE_VALUES.items():
        assert abs(result["parameters"][name] - value) < 6.0 * result["sigma"][name], name
    assert "Drive joints: 1 and 5 (reach" in answer.err
    assert "Explored" in answer.err
    assert "Capture complete: all 6 planned poses are taken." in answer.err
    events = {e.name for e in read_journal(folder).events}
    assert {"drives_chosen", "campaign", "campaign_move", "campaign_ended"} <= events


@pytest.mark.campaign
def test_figures_of_the_manual_agree_with_both_runs(tmp_path):
    page = (resources.files("operator_app") / "manual/pages/planned-poses.md").read_text()
    table = page.split("| `hinge` | `hinge_planned` |")[1].split("\n\n")[0]
    rows = [row.split("|")[2:4] for row in table.splitlines()[2:]]
    written = [[list(map(float, NUMBER.findall(cell))) for cell in row] for row in rows]
    for k, procedure in enumerate(("hinge", "hinge_planned")):
        result = finished(start(tmp_path, "run", procedure, "--json"), 0).json
        sigma, truth, captured = result["sigma"], result["truth"], result["capture"]
        offsets = [sigma[f"theta_off_{j}"] for j in range(1, 8)]
        lengths_mm = [1e3 * s for n, s in sigma.items() if n.startswith(("a_", "s_"))]
        expected = [
            [result["poses"]] if captured is None else [captured["explored"], captured["planned"]],
            [result["scaled_condition_number"]],
            [min(offsets[:5]), max(offsets[:5])],
            offsets[5:],
            [min(lengths_mm), max(lengths_mm)],
            [truth["predicted_mm_rms"], truth["tool_mm_rms"]],
            [result["best_table_tool_sigma_mm"]],
        ]
        for row, figures in zip(written, expected, strict=True):
            # Tolerance: other processors round differently.
            assert row[k] == pytest.approx(figures, rel=0.1)


@pytest.mark.campaign
def test_plan_uses_the_estimate_of_a_session(planned_run, run_command):
    folder, answer = planned_run
    count = answer.json["poses"]
    options = ["--session", "latest", "--sessions", folder.parent, "--poses", "2", "--json"]
    plan = run_command(0, "plan", *options).json
    assert plan["captured"] == count
    assert f"estimate of {count} poses" in plan["basis"]
    assert len(plan["poses"]) == 2
    # Of captured and planned poses together.
    assert plan["scaled_condition_number"] < 25
    # Errors are as large as the captured poses show: two more poses narrow the calibration's sigmas a little.
    for name, sigma in answer.json["sigma"].items():
        assert 0.6 * sigma < plan["sigma"][name] < 1.05 * sigma, name


@pytest.mark.campaign
def test_unreachable_requested_sigma_is_named_with_advice(tmp_path, run_command):
    document = yaml.safe_load(resolve("procedure", "hinge_planned").data)
    document["capture"] |= {"poses": 2, "requested_sigma": {"alpha_0_deg": 1e-9}}
    path = tmp_path / "procedure.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    out = run_command(0, "run", path, "--scenario", "exact", "--sessions", tmp_path / "s").out
    plan = out[out.index("Plan        ") : out.index("Session     ")]
    text = " ".join(plan.split())
    assert "alpha_0" in text
    assert "short of the request" in text
    assert "placement" in text
    assert max(len(row) for row in plan.splitlines()) <= 80


@recorded
def printed_plans() -> dict[str, str]:
    """Output of `sarcal plan` in Unicode, and in ASCII with advice."""
    outputs = {}
    for charset, extra in (("unicode", []), ("ascii", ["--ascii", "--advise", "--tries", "1"])):
        out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
        with contextlib.redirect_stdout(out):
            assert main(["plan", "hinge", "--poses", "6", *extra]) == 0
        outputs[charset] = out.buffer.getvalue().decode()
    return outputs


def test_plan_fits_80_columns_in_unicode_and_ascii():
    plan_output = printed_plans()
    for text in plan_output.values():
        table = text[text.index("visiting order") :].splitlines()[3:9]
        assert [row.split()[0] for row in table] == list("123456")
        assert all(len(row.split()) == 10 for row in table)
        assert max(len(row) for row in text.splitlines()) <= 80
        assert "\x1b" not in text
    assert any("\u2800" < c <= "\u28ff" for c in plan_output["unicode"])
    assert plan_output["ascii"].isascii()
    path = plan_output["ascii"].split("Path of the drive joints")[1].split("Ranges")[0]
    for label in ("S", "1", "6", "*", "J1 deg", "J5 deg"):
        assert label in path
    advice = plan_output["ascii"].split("Hinge placements")[1]
    for text in ("as it is", "mobility", "condition", "joint ranges reached: J1", "sigmas in mm"):
        assert text in advice


@pytest.mark.campaign
def test_a_plan_as_json_includes_advice(run_command):
    options = ["--poses", "4", "--tries", "1", "--advise", "--json"]
    plan = run_command(0, "plan", "hinge_planned", *options).json
    assert plan["basis"] == "nominal geometry"
    assert plan["mobility"] == 2
    assert plan["drives"]["joints"] == [1, 5]
    assert len(plan["drives"]["over_region"]) == 21
    for ranked in ("at_start", "over_region"):
        assert list(plan["drives"][ranked][0]) == [
            "joints", "score", "usable", "leverage", "passive_conditioning",
            "fastest_passive", "fastest_joint", "still", "reach", "reasons",
        ]  # fmt: skip
    assert [pose["number"] for pose in plan["poses"]] == [1, 2, 3, 4]
    first = plan["poses"][0]
    for joint, target in first["targets_deg"].items():
        assert target == first["predicted_deg"][int(joint) - 1]
    assert len(plan["sigma"]) == 14
    assert 1.0 < plan["scaled_condition_number"] < 50.0
    gains = [placement["gain"] for placement in plan["advice"]]
    assert gains == sorted(gains)
    best = plan["advice"][0]
    assert (best["mobility"], len(best["reach_deg"])) == (2, 7)
    assert set(best["sigma"]) == set(plan["sigma"])


def test_plan_without_unsensed_joints_omits_their_offsets(run_command):
    options = ["--poses", "4", "--unsensed", "6,7", "--json"]
    sigmas = run_command(0, "plan", "hinge", *options).json["sigma"]
    assert set(sigmas).isdisjoint({"theta_off_6", "theta_off_7"})


@pytest.mark.campaign
def test_plan_for_rigid_fixture_fixes_elbow_offset_and_gives_reason(run_command):
    text = run_command(0, "plan", "rigid", "--poses", "4").words
    assert "theta_off_4 is fixed at" in text
    assert "1 mm of length would pass for an offset" in text


@pytest.mark.campaign
def test_plan_ranks_the_drives_of_the_given_arm(run_command, tmp_path, monkeypatch):
    """The procedure's drive joints 1 and 5 are those of the packaged arm."""
    monkeypatch.chdir(tmp_path)
    arm = yaml.safe_load(resolve("arm", "sarcos_dextrous").data)
    arm |= {"name": "mine", "free": [f for f in arm["free"] if f != "theta_off_4"]}
    arm["home_deg"] = yaml.safe_load(resolve("procedure", "rigid").data)["home_deg"]
    Path("mine.yaml").write_text(yaml.safe_dump(arm, sort_keys=False))
    for procedure in ([], ["hinge"]):
        options = ["--arm", "mine.yaml", "--fixture", "rigid", "--poses", "2", "--json"]
        drives = run_command(0, "plan", *procedure, *options).json["drives"]
        assert drives["joints"] == [2]
        assert drives["reasons"][0].startswith("reaches ")
