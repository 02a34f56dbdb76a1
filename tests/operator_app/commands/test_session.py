"""`sarcal session`: list and show, text and JSON."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from operator_app.report.results.session import session_table_text, solved_json
from operator_app.session.store.folders import read_session


def test_json_has_the_parameters_in_the_units_of_a_report(journalled, run_command):
    folder = journalled["run"]
    root = ["--sessions", str(folder.parent)]
    reported = run_command(0, "report", folder, "--json").json["parameters"]
    shown = run_command(0, "session", "show", folder, "--json").json["solved"]["parameters"]
    listed = run_command(0, "session", "list", "--json", *root).json
    # The journal has the entries known within tolerances too.
    assert {name: shown[name] for name in reported} == pytest.approx(reported)
    (own,) = (entry for entry in listed if entry["folder"] == str(folder))
    assert own["solved"]["parameters"] == shown


def test_json_converts_the_angles_of_every_kind_of_parameter():
    values = {"theta_off_2": 1.0, "alpha_0[2]": 1.0, "base_rx": 1.0, "a_0[2]": 1.0, "base_x": 1.0}
    solved = {"accepted": True, "parameters": values}
    shown = solved_json(SimpleNamespace(solved=solved))["parameters"]
    assert list(shown.values()) == pytest.approx([math.degrees(1.0)] * 3 + [1.0] * 2)
    assert solved_json(SimpleNamespace(solved={})) == {}


def test_excluded_poses_are_named_as_poses(journalled, tmp_path, run_command):
    state = read_session(journalled["run"]).state
    for numbers, text in (((3,), ", pose 3 excluded"), ((3, 5), ", poses 3 and 5 excluded")):
        poses = [replace(p, excluded="test" if p.number in numbers else "") for p in state.poses]
        shown = session_table_text(
            tmp_path, replace(state, poses=tuple(poses)), procedure="", torn=""
        )
        assert text in " ".join(shown.split())
