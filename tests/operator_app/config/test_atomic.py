"""A file is written whole or not at all."""

import os
import stat

import pytest

from operator_app.config.atomic import write_atomically
from operator_app.config.errors import WriteError


def test_writes_and_replaces_and_leaves_nothing_behind(tmp_path):
    path = tmp_path / "a.yaml"
    write_atomically(path, b"one")
    write_atomically(path, b"two" * 10000)
    assert path.read_bytes() == b"two" * 10000
    assert [p.name for p in tmp_path.iterdir()] == ["a.yaml"]


def test_a_new_file_has_ordinary_permissions_and_an_old_one_keeps_its_own(tmp_path):
    path = tmp_path / "a.yaml"
    old = os.umask(0o027)
    try:
        write_atomically(path, b"one")
    finally:
        os.umask(old)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    path.chmod(0o604)
    write_atomically(path, b"two")
    assert stat.S_IMODE(path.stat().st_mode) == 0o604


@pytest.mark.parametrize("there", [True, False])
def test_a_link_is_replaced_and_what_it_points_to_is_left_alone(tmp_path, there):
    target, link = tmp_path / "elsewhere/target", tmp_path / "link"
    target.parent.mkdir()
    if there:
        target.write_bytes(b"old")
        target.chmod(0o600)
    link.symlink_to(target)
    write_atomically(link, b"new")
    assert not link.is_symlink()
    assert link.read_bytes() == b"new"
    write_atomically(tmp_path / "plain", b"new")
    assert link.stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert (target.read_bytes() == b"old") if there else not target.exists()


def test_a_link_of_the_user_s_own_stays_a_link(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_atomically(link, b"new", through_link=True)
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@pytest.mark.parametrize("linked", [True, False])
def test_a_pipe_or_device_is_not_replaced(tmp_path, linked):
    """As root, `export -o /dev/full` had put a file in place of the device."""
    path = pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    if linked:
        path = tmp_path / "link"
        path.symlink_to(pipe)
    with pytest.raises(WriteError):
        write_atomically(path, b"new")
    assert stat.S_ISFIFO(path.stat().st_mode)


FULL = OSError(28, "No space left on device")


@pytest.mark.parametrize(
    ("step", "error", "raised", "words"),
    [
        ("fsync", FULL, WriteError, r"a\.yaml: cannot be written: No space left on device"),
        ("fchmod", FULL, WriteError, r"a\.yaml: cannot be written: No space left on device"),
        ("fsync", KeyboardInterrupt(), KeyboardInterrupt, None),
    ],
)
def test_a_disk_that_fails_and_ctrl_c_leave_the_old_file(
    tmp_path, monkeypatch, step, error, raised, words
):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(raised, match=words):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.yaml"]


def test_the_file_is_on_the_disk_before_the_rename_and_the_folder_after_it(tmp_path, monkeypatch):
    path = tmp_path / "a.yaml"
    seen: list[tuple[bool, bool]] = []
    real = os.fsync

    def watch(handle):
        seen.append((stat.S_ISDIR(os.fstat(handle).st_mode), path.exists()))
        real(handle)

    monkeypatch.setattr(os, "fsync", watch)
    write_atomically(path, b"x")
    assert seen == [(False, False), (True, True)]


def test_no_folder_is_said(tmp_path):
    with pytest.raises(WriteError, match="No such file or directory"):
        write_atomically(tmp_path / "none" / "a.yaml", b"x")
