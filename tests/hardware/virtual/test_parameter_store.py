import itertools
import os

import pytest

from hardware.canopen.objects import Slot, SlotState
from hardware.virtual.parameter_store import Disk, FolderDisk, ParameterStore

FIRST, SECOND, THIRD, FOURTH = b"first document\n", b"second document\n" * 40, b"third", b"fourth"


class PowerCut(Exception):
    pass


class CutDisk(Disk):
    """A disk that loses power during its k-th operation.

    A write that is cut leaves any part of the data, or no file; a rename that is cut has happened or has not. Finished
    operations persist.
    """

    def __init__(self, files: dict[str, bytes], cut_at: int = 10**6, outcome: int = 0) -> None:
        self.files = dict(files)
        self.cut_at, self.outcome = cut_at, outcome
        self.operations = 0

    def _is_cut(self) -> bool:
        self.operations += 1
        return self.operations > self.cut_at

    def write(self, name: str, data: bytes) -> None:
        if self._is_cut():
            parts = [None, b"", data[:1], data[: len(data) // 2], data[:-1], data, bytes(len(data))]
            part = parts[self.outcome]
            if part is None:
                self.files.pop(name, None)
            else:
                self.files[name] = part
            raise PowerCut
        self.files[name] = data

    def rename(self, old: str, new: str) -> None:
        cut = self._is_cut()
        if not cut or self.outcome % 2:
            self.files[new] = self.files.pop(old)
        if cut:
            raise PowerCut


def commit(store: ParameterStore) -> None:
    store.commit(THIRD)


@pytest.mark.parametrize(
    ("before", "operation", "results"),
    [
        ((), commit, {None, THIRD}),
        ((FIRST,), commit, {FIRST, THIRD}),
        ((FIRST, SECOND), commit, {SECOND, THIRD}),
        ((FIRST, SECOND), ParameterStore.roll_back, {FIRST, SECOND}),
    ],
)
def test_power_cut_leaves_the_old_or_the_new_document(before, operation, results):
    disk = CutDisk({})
    for document in before:
        ParameterStore(disk).commit(document)
    counting = CutDisk(disk.files)
    operation(ParameterStore(counting))
    documents = set()
    for cut_at, outcome in itertools.product(range(counting.operations), range(7)):
        cut = CutDisk(disk.files, cut_at, outcome)
        with pytest.raises(PowerCut):
            operation(ParameterStore(cut))
        store = ParameterStore(CutDisk(cut.files))
        documents.add(store.document(store.active))
        # The next commit works whatever the power cut left.
        store.commit(FOURTH)
        assert store.document(store.active) == FOURTH
    assert documents == results


def test_commits_and_roll_backs_alternate_between_slots():
    store = ParameterStore()
    assert (store.active, store.state(Slot.A)) == (Slot.NONE, SlotState.EMPTY)
    assert store.document(store.active) is None
    assert store.commit(FIRST) is Slot.A
    assert store.document(store.active) == FIRST
    assert [store.commit(document) for document in (SECOND, THIRD)] == [Slot.B, Slot.A]
    assert store.document(Slot.B) == SECOND
    assert store.roll_back() is Slot.B
    assert store.document(store.active) == SECOND
    assert store.roll_back() is Slot.A


@pytest.mark.parametrize("document", [b"", b"\n", b"\x00\xff" * 100, b"no line end"])
def test_any_document_is_read_back_from_a_folder(tmp_path, document):
    folder = tmp_path / "slots"
    ParameterStore(FolderDisk(folder)).commit(document)
    reopened = ParameterStore(FolderDisk(folder))
    assert reopened.document(reopened.active) == document
    assert sorted(file.name for file in folder.iterdir()) == ["active", "slot_a"]


def test_flipped_bit_or_invalid_active_file_means_no_slot(tmp_path):
    store = ParameterStore(FolderDisk(tmp_path))
    store.commit(FIRST)
    store.commit(SECOND[:20])
    stored = (tmp_path / "slot_b").read_bytes()
    for index, byte in enumerate(stored):
        (tmp_path / "slot_b").write_bytes(stored[:index] + bytes([byte ^ 1]) + stored[index + 1 :])
        assert store.state(Slot.B) is SlotState.DAMAGED
        assert store.active is Slot.NONE
        assert store.document(Slot.A) == FIRST
    (tmp_path / "slot_b").write_bytes(stored)
    assert store.active is Slot.B
    (tmp_path / "active").write_bytes(b"C")
    assert store.active is Slot.NONE


def test_pipe_in_place_of_a_slot_is_an_error_at_once(tmp_path):
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
