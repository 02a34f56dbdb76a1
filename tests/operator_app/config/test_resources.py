"""Built-in names, paths, and files that cannot be read."""

from pathlib import Path

import pytest

from operator_app.commands.options import a_path
from operator_app.config.errors import ConfigError
from operator_app.config.resources import YAML_LIMIT_BYTES, resolve


def refusal_of(kind, reference):
    with pytest.raises(ConfigError) as caught:
        resolve(kind, reference)
    assert len(caught.value.problems) == 1
    return str(caught.value)


def test_built_in_name_takes_precedence_over_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("hinge").write_text("mine")
    assert resolve("fixture", "hinge").file == "packaged:hinge.yaml"
    assert resolve("fixture", "./hinge").data == b"mine"
    assert resolve("fixture", Path("hinge")).data == b"mine"


def test_tilde_after_a_folder_is_part_of_the_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("~", "~nosuchuser"):
        Path(tmp_path / name).write_text("mine")
        assert resolve("fixture", f"./{name}").data == b"mine"
        assert a_path(f"./{name}") == Path(name)


def test_unusable_files_are_refused(tmp_path):
    assert refusal_of("arm", "").startswith("'': is neither a built-in arm nor a file; built-in: ")
    assert "is a folder" in refusal_of("arm", tmp_path)
    assert "no such file" in refusal_of("arm", str(tmp_path / "none" / "a.yaml"))
    assert "cannot be read" in refusal_of("arm", "a\0.yaml")
    assert "cannot be read" in refusal_of("arm", "a" * 5000 + ".yaml")
    (tmp_path / "file").write_bytes(b"")
    assert "cannot be read" in refusal_of("arm", str(tmp_path / "file" / "a.yaml"))
    big = tmp_path / "big.yaml"
    big.write_bytes(b"#" * (YAML_LIMIT_BYTES + 1))
    assert "larger than 256 KiB" in refusal_of("arm", str(big))
    assert "larger than" in refusal_of("arm", "/dev/zero")
    # Can be opened, but not read, even by root.
    assert "cannot be read: Input/output error" in refusal_of("arm", "/proc/self/mem")
