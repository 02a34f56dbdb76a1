"""Power cuts at every point of a commit, with everything an operating system may have done by then."""

import itertools
import os

import pytest

from hardware.canopen.objects import Slot, SlotState
from hardware.virtual.parameter_store import Disk, FolderDisk, ParameterStore

FIRST, SECOND, THIRD = b"first document\n", b"second document\n" * 40, b"third"


class PowerCut(Exception):
    pass


class CutDisk(Disk):
    """A disk that loses power during its k-th operation.

    A write that is cut leaves any part of the data, or no file; a rename that is cut has happened or
    has not. What was finished stays.
    """

    def __init__(self, files: dict[str, bytes], cut_at: int, outcome: int) -> None:
        self.files = dict(files)
        self.left, self.outcome = cut_at, outcome
        self.operations = 0

    def _operate(self) -> bool:
        self.operations += 1
        self.left -= 1
        return self.left < 0

    def write(self, name: str, data: bytes) -> None:
        if self._operate():
            parts = [None, b"", data[:1], data[: len(data) // 2], data[:-1], data, bytes(len(data))]
            part = parts[self.outcome]
            if part is None:
                self.files.pop(name, None)
            else:
                self.files[name] = part
            raise PowerCut
        self.files[name] = data

    def rename(self, old: str, new: str) -> None:
        cut = self._operate()
        if not cut or self.outcome % 2:
            self.files[new] = self.files.pop(old)
        if cut:
            raise PowerCut


OUTCOMES = range(7)


def committed(*documents: bytes) -> dict[str, bytes]:
    disk = CutDisk({}, 10**6, 0)
    store = ParameterStore(disk)
    for document in documents:
        store.commit(document)
    return disk.files


@pytest.mark.parametrize("before", [(), (FIRST,), (FIRST, SECOND)])
def test_a_commit_cut_at_any_point_leaves_old_or_new_whole(before):
    counting = CutDisk(committed(*before), 10**6, 0)
    ParameterStore(counting).commit(THIRD)
    old = before[-1] if before else None
    seen = set()
    for cut_at, outcome in itertools.product(range(counting.operations), OUTCOMES):
        disk = CutDisk(committed(*before), cut_at, outcome)
        with pytest.raises(PowerCut):
            ParameterStore(disk).commit(THIRD)
        after = ParameterStore(CutDisk(disk.files, 10**6, 0))
        document = after.document(after.active)
        assert document in (old, THIRD)
        seen.add(document)
        # And life goes on: the next commit works whatever was left behind.
        after.commit(SECOND)
        assert after.document(after.active) == SECOND
    assert seen == {old, THIRD}


def test_a_roll_back_cut_at_any_point_leaves_one_of_the_two():
    for cut_at, outcome in itertools.product(range(2), OUTCOMES):
        disk = CutDisk(committed(FIRST, SECOND), cut_at, outcome)
        with pytest.raises(PowerCut):
            ParameterStore(disk).roll_back()
        after = ParameterStore(CutDisk(disk.files, 10**6, 0))
        assert after.document(after.active) in (FIRST, SECOND)


def test_slots_take_turns():
    store = ParameterStore()
    assert (store.active, store.state(Slot.A), store.document(store.active)) == (
        Slot.NONE,
        SlotState.EMPTY,
        None,
    )
    assert [store.commit(d) for d in (FIRST, SECOND, THIRD)] == [Slot.A, Slot.B, Slot.A]
    assert store.document(Slot.B) == SECOND
    assert store.roll_back() is Slot.B
    assert store.document(store.active) == SECOND
    assert store.roll_back() is Slot.A


def test_nothing_to_roll_back_to():
    store = ParameterStore()
    with pytest.raises(ValueError, match="no whole document"):
        store.roll_back()
    store.commit(FIRST)
    with pytest.raises(ValueError, match="slot B"):
        store.roll_back()
    assert store.document(store.active) == FIRST


@pytest.mark.parametrize("document", [b"", b"\n", b"\x00\xff" * 100, b"no line end"])
def test_any_bytes_survive_a_real_folder(tmp_path, document):
    folder = tmp_path / "slots"
    ParameterStore(FolderDisk(folder)).commit(document)
    again = ParameterStore(FolderDisk(folder))
    assert again.document(again.active) == document
    assert sorted(file.name for file in folder.iterdir()) == ["active", "slot_a"]


def test_every_flipped_bit_in_a_slot_is_noticed(tmp_path):
    store = ParameterStore(FolderDisk(tmp_path))
    store.commit(FIRST)
    store.commit(SECOND[:20])
    stored = (tmp_path / "slot_b").read_bytes()
    for place in range(len(stored)):
        (tmp_path / "slot_b").write_bytes(
            stored[:place] + bytes([stored[place] ^ 1]) + stored[place + 1 :]
        )
        assert store.state(Slot.B) is SlotState.DAMAGED
        assert store.active is Slot.NONE
        assert store.document(Slot.A) == FIRST


def test_a_pipe_in_the_place_of_a_slot_is_an_error_and_keeps_nobody_waiting(tmp_path):
    os.mkfifo(tmp_path / "slot_a")
    store = ParameterStore(FolderDisk(tmp_path))
    with pytest.raises(OSError, match="not a file"):
        store.state(Slot.A)
    os.mkfifo(tmp_path / "slot_b.new")
    (tmp_path / "slot_a").unlink()
    assert store.commit(b"first") is Slot.A
    with pytest.raises(OSError, match="slot_b"):
        store.commit(b"second")
    assert store.document(store.active) == b"first"


def test_an_unknown_pointer_names_no_slot(tmp_path):
    store = ParameterStore(FolderDisk(tmp_path))
    store.commit(FIRST)
    (tmp_path / "active").write_bytes(b"C")
    assert store.active is Slot.NONE
