"""Tests are in the folder of their module: solver/chain/poses.py -> tests/solver/chain/test_poses.py."""

import json
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("solver", "fixtures", "hardware", "operator_app")

TOPICS = """
hardware/virtual/test_control_and_heartbeat.py
operator_app/calibration/test_honesty.py
operator_app/calibration/test_real_arm.py
operator_app/calibration/test_convergence.py
operator_app/commands/test_command_line.py
operator_app/commands/test_stored_results.py
operator_app/manual/test_commands.py
operator_app/report/test_renderings.py
operator_app/session/test_capture_faults.py
operator_app/session/test_journal_loss.py
operator_app/session/test_open_arm.py
operator_app/session/test_placements.py
operator_app/test_fuzz.py
operator_app/test_loaded_modules.py
operator_app/test_recording.py
operator_app/tui/test_actions.py
operator_app/tui/test_faults.py
operator_app/tui/test_keys.py
operator_app/tui/test_panels.py
operator_app/tui/test_snapshots.py
operator_app/tui/test_stop.py
operator_app/tui/test_full_session.py
solver/estimators/test_mixed_model.py
"""
"""Files on several modules of their folder. The list may only get shorter."""


def names_a_module(file: Path) -> bool:
    """Whether a module or package has the name of the file or of its folder."""
    stem, folder = file.stem.removeprefix("test_"), ROOT / file.parent
    package = folder / stem
    return (
        package.with_suffix(".py").is_file()
        or (package / "__init__.py").is_file()
        or folder.with_suffix(".py").is_file()
        or (folder.name == stem and folder.is_dir())
    )


def test_every_test_file_has_its_module_or_is_listed():
    tests = ROOT / "tests"
    files = [f.relative_to(tests) for p in PACKAGES for f in (tests / p).rglob("test_*.py")]
    assert len(files) > 200
    unnamed = {f.as_posix() for f in files if not names_a_module(f)}
    topics = set(TOPICS.split())
    assert sorted(unnamed - topics) == [], (
        "name it after its module and move it to the folder of that module"
    )
    assert sorted(topics - unnamed) == [], "removed or renamed: delete it from the list"


def test_every_approved_sentence_belongs_to_a_test():
    for name in json.loads((ROOT / "tests" / "approved_words.json").read_text("utf-8")):
        file, function = name.partition("[")[0].split(" #")[0].rsplit("::", 1)
        assert f"def {function}(" in (ROOT / "tests" / file.split("::")[0]).read_text("utf-8"), name
