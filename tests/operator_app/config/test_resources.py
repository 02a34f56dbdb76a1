"""Built-in names, paths, and files that cannot be read."""

from pathlib import Path

import pytest

from operator_app.config.errors import ConfigError
from operator_app.config.resources import YAML_LIMIT_BYTES, builtin_names, resolve


def refusal(kind, reference, folder=None):
    with pytest.raises(ConfigError) as caught:
        resolve(kind, reference, folder=folder)
    assert len(caught.value.problems) == 1
    return str(caught.value)


def test_built_in_names():
    assert builtin_names("arm") == (
        "abb_irb120",
        "franka_fr3",
        "franka_panda",
        "kinova_gen3",
        "kinova_gen3_lite",
        "kuka_iiwa14",
        "kuka_iiwa7",
        "sarcos_dextrous",
        "ur10e",
        "ur5e",
        "xarm6",
        "xarm7",
    )
    assert {"hinge", "rigid"} <= set(builtin_names("fixture"))
    assert {"hinge", "rigid"} <= set(builtin_names("procedure"))


def test_a_built_in_name_wins_over_a_file_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("hinge").write_text("mine")
    assert resolve("fixture", "hinge").file == "packaged:hinge.yaml"
    assert resolve("fixture", "./hinge").data == b"mine"
    assert resolve("fixture", Path("hinge")).data == b"mine"


def test_a_name_that_is_neither_lists_what_there_is():
    said = refusal("fixture", "hindge")
    assert said.startswith("hindge: is neither a built-in fixture nor a file; did you mean hinge?")
    assert "hinge, rigid" in said
    assert "did you mean ur5e?" in refusal("arm", "UR5e")


def test_relative_paths_start_from_the_folder(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "f.yaml").write_bytes(b"x: 1\n")
    found = resolve("fixture", "f.yaml", folder=tmp_path / "sub")
    assert found.data == b"x: 1\n"
    assert found.folder == tmp_path / "sub"
    assert "did you mean" in refusal("fixture", "g.yaml", tmp_path / "sub")


def test_files_that_cannot_be_used(tmp_path):
    assert refusal("arm", "").startswith("'': is neither a built-in arm nor a file; built-in: ")
    assert "is a folder" in refusal("arm", tmp_path)
    assert "no such file" in refusal("arm", str(tmp_path / "none" / "a.yaml"))
    assert "cannot be read" in refusal("arm", "a\0.yaml")
    assert "cannot be read" in refusal("arm", "a" * 5000 + ".yaml")
    (tmp_path / "file").write_bytes(b"")
    assert "cannot be read" in refusal("arm", str(tmp_path / "file" / "a.yaml"))
    big = tmp_path / "big.yaml"
    big.write_bytes(b"#" * (YAML_LIMIT_BYTES + 1))
    assert "larger than 256 KiB" in refusal("arm", str(big))
    assert "larger than" in refusal("arm", "/dev/zero")
    # Opens, and gives no byte to anybody, root included.
    assert "cannot be read: Input/output error" in refusal("arm", "/proc/self/mem")
