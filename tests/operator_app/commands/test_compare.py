"""`sarcal compare` as a script sees it: files or sessions, JSON, exit codes, words when it cannot."""

from dataclasses import replace
from pathlib import Path

import pytest

from operator_app.config.parameter_records import WhichArm
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import save_parameters
from operator_app.session.store.journal import Journal
from tests.oracles.parameter_documents import VALUES, make_document


def saved(path: Path, document: ParametersDocument) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_parameters(path, document)
    return str(path)


def test_no_drift_is_0_and_drift_is_4(tmp_path, ends_with):
    one = saved(tmp_path / "a.yaml", make_document())
    same = saved(tmp_path / "b.yaml", make_document({"theta_off_3": 0.001}, poses="b"))
    other = saved(tmp_path / "c.yaml", make_document({"theta_off_3": 0.02}, poses="c"))
    assert ends_with(0, "compare", one, same).out.startswith("NO SIGNIFICANT DRIFT")
    said = ends_with(4, "compare", one, other).out
    assert said.startswith("DRIFTED:\n- theta_off_3 by +0.0200 deg (14.1 sigmas; arm)")
    ends_with(0, "compare", one, other, "--level", "1e-60")


def test_json_has_every_parameter_in_the_units_of_the_file(tmp_path, ends_with):
    one = saved(tmp_path / "a.yaml", make_document())
    other = saved(tmp_path / "b.yaml", make_document({"a_7": 0.001}, poses="b"))
    found = ends_with(4, "compare", one, other, "--json").json
    assert found["verdict"] == "drifted"
    assert found["drifted"] == ["a_7"]
    assert set(found["parameters"]) == set(VALUES)
    a_7 = found["parameters"]["a_7"]
    assert a_7["unit"] == "m"
    assert a_7["a"] == pytest.approx(-0.101)
    assert a_7["change"] == pytest.approx(0.001)
    assert a_7["sigma"] == pytest.approx(1.414e-5, rel=1e-3)
    assert a_7["side"] == "hand"
    assert found["parameters"]["alpha_0"]["a"] == pytest.approx(-38.5)
    assert found["a"]["arm_serial"] == found["b"]["arm_serial"] == "SDA-0001"
    assert found["a"]["utc"] == "2026-01-31T12:00:00Z"


def test_sessions_are_named_by_folder_or_name(tmp_path, ends_with):
    for name, change, poses in (("one", 0.0, "a"), ("two", 1.0, "b")):
        folder = tmp_path / "sessions" / name
        Journal.create(folder).close()
        saved(folder / "parameters.yaml", make_document({"theta_off_2": change}, poses=poses))
    root = ["--sessions", str(tmp_path / "sessions")]
    ends_with(4, "compare", "one", "two", *root)
    ends_with(4, "compare", tmp_path / "sessions" / "one", "latest", *root)
    ends_with(0, "compare", "one", "one", *root)
    Journal.create(tmp_path / "sessions" / "three").close()
    said = ends_with(2, "compare", "one", "three", *root).err
    assert "has no parameters.yaml. Write it with: sarcal export" in said


def test_what_cannot_be_compared_ends_in_2_with_words(tmp_path, ends_with):
    one = saved(tmp_path / "a.yaml", make_document())
    other_arm = replace(make_document(), arm=WhichArm(model="sarcos_dextrous", serial="SDA-0002"))
    other = saved(tmp_path / "b.yaml", other_arm)
    broken = tmp_path / "c.yaml"
    broken.write_text("schema: sarcal/parameters/1\n")
    for arguments, words in (
        ([one, other], "SDA-0002"),
        ([one, str(broken)], "c.yaml"),
        ([one, str(tmp_path / "none")], "is not a session"),
        ([one, one, "--level", "2"], "--level 2: a probability is between 0 and 1"),
        ([one, one, "--level", "nan"], "between 0 and 1"),
    ):
        said = ends_with(2, "compare", *arguments)
        assert said.out == ""
        assert words in said.err
        assert "Traceback" not in said.err


def test_remounted_compares_the_arm_only(tmp_path, ends_with):
    one = saved(tmp_path / "a.yaml", make_document())
    moved = saved(tmp_path / "b.yaml", make_document({"s_1": 0.02, "alpha_7": 3.0}, poses="b"))
    ends_with(4, "compare", one, moved)
    found = ends_with(0, "compare", one, moved, "--remounted", "--json").json
    assert set(found["parameters"]) == {f"theta_off_{j}" for j in range(2, 7)}
    assert found["left_out"]["s_1"] == "the fixture was remounted"
