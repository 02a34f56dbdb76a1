"""`sarcal export`: parameters are uploaded to the session's arm, journalled, and written into its folder."""

import hashlib
import json
from importlib.resources import files
from pathlib import Path

import pytest

from operator_app.cli import main
from operator_app.config.parameters_file import load_parameters
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state


@pytest.mark.campaign
def test_upload_is_journalled_with_its_reason(tmp_path, run_command):
    options = ["--sessions", str(tmp_path / "sessions")]
    procedure = tmp_path / "strict.yaml"
    packaged = (files("operator_app") / "data/procedures/hinge.yaml").read_text()
    # A limit that no arm meets.
    procedure.write_text(packaged.replace("scaled_condition_number: 100", "sigma_pos_mm: 0.000001"))
    run_command(4, "run", procedure, "--poses", "4", *options)
    (folder,) = (tmp_path / "sessions").iterdir()
    assert "not accepted: " in run_command(4, "export", folder.name, "--upload", *options).err
    assert not (folder / "parameters.yaml").exists()
    comparison = run_command(0, "compare", folder.name, folder.name, *options).out
    assert "! A was not accepted (" in comparison

    copy = tmp_path / "copy.yaml"
    forced = ["--upload", "--force", "the demo is tonight", "-o", str(copy)]
    assert "slot A active" in run_command(4, "export", folder.name, *forced, *options).out
    assert copy.read_bytes() == (folder / "parameters.yaml").read_bytes()
    exported = session_state(read_journal(folder)).exported
    assert (exported["forced"], exported["uploaded"]["slot"]) == ("the demo is tonight", "A")

    # The journal records the solution of the other estimator as exported.
    other = ["--upload", "--estimator", "paper", "--force", "to compare", "-o", str(copy), "--json"]
    comparison = run_command(4, "export", folder.name, *other, *options)
    assert "calibrated again" in comparison.err
    result = json.loads(comparison.out)
    assert result["file"] == str(copy)
    assert result["forced"] == "to compare"
    assert result["uploaded"]["sha256"] == hashlib.sha256(copy.read_bytes()).hexdigest()
    events = read_journal(folder).events
    assert [e.name for e in events].count("control") == 1, "an upload enables no drive"
    # The outcome is recorded as unknown before the upload, and again after it.
    solved, begun, exported = [e for e in events if e.name in ("solved", "exported")][-3:]
    assert "unknown" in begun.data
    assert solved.data["estimator"] == "paper"
    assert session_state(read_journal(folder)).solution == solved.data["record"]
    document = load_parameters(copy)
    assert document.estimator == "paper"
    assert exported.data["sha256"] == hashlib.sha256(copy.read_bytes()).hexdigest()
    for name in ("theta_off_2", "theta_off_6"):
        value_rad = document.theta_off_rad[int(name[-1]) - 1]
        assert solved.data["parameters"][name] == pytest.approx(value_rad, rel=1e-14)


def test_links_in_a_session_folder_are_replaced(tmp_path):
    """Links in a received folder may point anywhere; nothing outside the folder is written."""
    root = ["--sessions", str(tmp_path / "sessions")]
    hinge = Path(__file__).parents[2] / "data/hinge/hinge_exact.csv"
    assert main(["import", str(hinge), *root]) == 0
    (folder,) = (tmp_path / "sessions").iterdir()
    precious = tmp_path / "precious"
    precious.write_text("mine")
    names = ("report.html", "parameters.yaml", "result.json", "parameters.csv", "arm.urdf")
    for name in names:
        (folder / name).symlink_to(precious)
    assert main(["report", "latest", *root]) == 0
    for kind in ("yaml", "json", "csv", "urdf"):
        assert main(["export", "latest", "--format", kind, *root]) == 0
    assert precious.read_text() == "mine"
    assert not any((folder / name).is_symlink() for name in names)
    assert all((folder / name).stat().st_size > 100 for name in names)
