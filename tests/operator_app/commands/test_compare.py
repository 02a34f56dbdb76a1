"""`sarcal compare`: files or sessions, JSON, exit codes, errors."""

import shutil
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest
import sarcal

from operator_app.config.parameter_records import WhichArm
from operator_app.config.parameters_file import ParametersDocument, load_parameters, save_parameters
from operator_app.session.store.journal import Journal, read_journal
from tests.oracles.parameter_documents import VALUES, make_document


def save(path: Path, document: ParametersDocument) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_parameters(path, document)
    return str(path)


def test_exit_code_is_0_without_drift_and_4_with_drift(tmp_path, run_command):
    one = save(tmp_path / "a.yaml", make_document())
    same = save(tmp_path / "b.yaml", make_document({"theta_off_3": 0.001}, poses="b"))
    other = save(tmp_path / "c.yaml", make_document({"theta_off_3": 0.02}, poses="c"))
    assert run_command(0, "compare", one, same).out.startswith("NO SIGNIFICANT DRIFT")
    message = run_command(4, "compare", one, other).out
    assert message.startswith("DRIFTED:\n- theta_off_3 by +0.0200 deg (14.1 sigmas; arm)")
    run_command(0, "compare", one, other, "--level", "1e-60")


def test_json_has_every_parameter_in_file_units(tmp_path, run_command):
    one = save(tmp_path / "a.yaml", make_document())
    other = save(tmp_path / "b.yaml", make_document({"a_7": 0.001}, poses="b"))
    comparison = run_command(4, "compare", one, other, "--json").json
    assert comparison["verdict"] == "drifted"
    assert comparison["drifted"] == ["a_7"]
    assert set(comparison["parameters"]) == set(VALUES)
    a_7 = comparison["parameters"]["a_7"]
    assert a_7["unit"] == "m"
    assert a_7["a"] == pytest.approx(-0.101)
    assert a_7["change"] == pytest.approx(0.001)
    assert a_7["sigma"] == pytest.approx(1.414e-5, rel=1e-3)
    assert a_7["side"] == "hand"
    assert comparison["parameters"]["alpha_0"]["a"] == pytest.approx(-38.5)
    assert comparison["a"]["arm_serial"] == comparison["b"]["arm_serial"] == "SDA-0001"
    assert comparison["a"]["utc"] == "2026-01-31T12:00:00Z"
    remounted = run_command(0, "compare", one, other, "--remounted", "--json").json
    assert set(remounted["parameters"]) == {f"theta_off_{j}" for j in range(2, 7)}
    assert remounted["left_out"]["a_7"] == "the fixture was remounted"


def test_sessions_are_given_by_folder_or_name(tmp_path, run_command):
    for name, change, poses in (("one", 0.0, "a"), ("two", 1.0, "b")):
        folder = tmp_path / "sessions" / name
        Journal.create(folder).close()
        save(folder / "parameters.yaml", make_document({"theta_off_2": change}, poses=poses))
    root = ["--sessions", str(tmp_path / "sessions")]
    run_command(4, "compare", tmp_path / "sessions" / "one", "latest", *root)
    run_command(0, "compare", "one", "one", *root)
    Journal.create(tmp_path / "sessions" / "three").close()
    message = run_command(2, "compare", "one", "three", *root).err
    assert "has no parameters.yaml. Write it with: sarcal export" in message


def test_documents_that_cannot_be_compared_are_refused(tmp_path, run_command):
    one = save(tmp_path / "a.yaml", make_document())
    other_arm = replace(make_document(), arm=WhichArm(model="sarcos_dextrous", serial="SDA-0002"))
    other = save(tmp_path / "b.yaml", other_arm)
    broken = tmp_path / "c.yaml"
    broken.write_text("schema: sarcal/parameters/1\n")
    for arguments, message in (
        ([one, other], "SDA-0002"),
        ([one, str(broken)], "c.yaml"),
        ([one, str(tmp_path / "none")], "is not a session"),
        ([one, one, "--level", "2"], "--level: 2 is not a number between 0 and 1"),
        *(([one, one, "--level", level], "between 0 and 1") for level in ("0", "1", "nan")),
    ):
        answer = run_command(2, "compare", *arguments)
        assert answer.out == ""
        assert message in answer.err


def test_a_calibration_has_one_date_in_folder_export_and_python(journalled, tmp_path, run_command):
    """The date of the calibration: one written later is not newer."""
    folder = tmp_path / "run"
    shutil.copytree(journalled["run"], folder)
    file = tmp_path / "later.yaml"
    run_command(0, "export", folder, "-o", file)
    result = sarcal.load_result(folder)
    result.export(tmp_path / "python.yaml")
    solved = [e.utc for e in read_journal(folder).events if e.name == "solved"][-1]
    for before in (str(folder), str(file), str(tmp_path / "python.yaml"), result):
        comparison = sarcal.compare(before, str(folder)).to_json()
        assert datetime.fromisoformat(comparison["a"]["utc"]) == datetime.fromisoformat(solved)
        assert comparison["b"]["utc"] == comparison["a"]["utc"]
        assert "ORDER" not in [n["code"] for n in comparison["warnings"]]
    made = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=result.poses)
    made.save(tmp_path / "saved")
    assert load_parameters(tmp_path / "saved" / "parameters.yaml").utc == made._document().utc
