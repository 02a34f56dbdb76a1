"""Atomic writes: the new content or the old file, never a part."""

import os
import stat

import pytest

from operator_app.config.atomic import write_atomically
from operator_app.config.errors import WriteError


def test_new_file_follows_umask_and_replaced_file_keeps_its_mode(tmp_path):
    path = tmp_path / "a.yaml"
    umask = os.umask(0o027)
    try:
        write_atomically(path, b"one")
    finally:
        os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    path.chmod(0o604)
    write_atomically(path, b"two" * 10000)
    assert path.read_bytes() == b"two" * 10000
    assert stat.S_IMODE(path.stat().st_mode) == 0o604
    assert [p.name for p in tmp_path.iterdir()] == ["a.yaml"]


@pytest.mark.parametrize("target_exists", [True, False])
def test_link_is_replaced_and_its_target_is_unchanged(tmp_path, target_exists):
    target, link = tmp_path / "elsewhere/target", tmp_path / "link"
    target.parent.mkdir()
    if target_exists:
        target.write_bytes(b"old")
        target.chmod(0o600)
    link.symlink_to(target)
    write_atomically(link, b"new")
    assert not link.is_symlink()
    assert link.read_bytes() == b"new"
    write_atomically(tmp_path / "plain", b"new")
    assert link.stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert (target.read_bytes() == b"old") if target_exists else not target.exists()


def test_through_link_writes_the_target(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_atomically(link, b"new", through_link=True)
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@pytest.mark.parametrize("linked", [True, False])
def test_pipe_or_device_is_not_replaced(tmp_path, linked):
    path = pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    if linked:
        path = tmp_path / "link"
        path.symlink_to(pipe)
    with pytest.raises(WriteError):
        write_atomically(path, b"new")
    assert stat.S_ISFIFO(path.stat().st_mode)


DISK_FULL = OSError(28, "No space left on device")


@pytest.mark.parametrize(
    ("function", "error", "raised", "words"),
    [
        ("fsync", DISK_FULL, WriteError, r"a\.yaml: cannot be written: No space left on device"),
        ("fchmod", DISK_FULL, WriteError, r"a\.yaml: cannot be written: No space left on device"),
        ("fsync", KeyboardInterrupt(), KeyboardInterrupt, None),
    ],
)
def test_failed_write_or_interrupt_leaves_the_old_file(
    tmp_path, monkeypatch, function, error, raised, words
):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, function, fail)
    with pytest.raises(raised, match=words):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.yaml"]


def test_file_is_synced_before_rename_and_folder_after_it(tmp_path, monkeypatch):
    path = tmp_path / "a.yaml"
    syncs: list[tuple[bool, bool]] = []
    fsync = os.fsync

    def record_sync(handle):
        syncs.append((stat.S_ISDIR(os.fstat(handle).st_mode), path.exists()))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", record_sync)
    write_atomically(path, b"x")
    assert syncs == [(False, False), (True, True)]


def test_in_a_folder_that_may_not_be_read_the_file_is_written(tmp_path, monkeypatch):
    os_open = os.open

    def refuse_folder(path, *options):
        if path == tmp_path:
            raise PermissionError(13, "Permission denied")
        return os_open(path, *options)

    monkeypatch.setattr(os, "open", refuse_folder)
    write_atomically(tmp_path / "a.yaml", b"new")
    assert (tmp_path / "a.yaml").read_bytes() == b"new"
