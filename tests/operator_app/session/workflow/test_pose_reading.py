"""Errors of a pose reading, with a test's own arm, and of the ports of instruments."""

import contextlib
import itertools
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hardware.arm import Reading
from hardware.errors import InstrumentError
from hardware.line_port import LONGEST, CalledLines, GrowingFile, StdinLines, TcpLines
from hardware.virtual.tracker import CLIENTS, serve_tracker
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError, SessionError
from operator_app.session.workflow.pose_reading import Instrument, TargetLostError, port_of
from tests.oracles.plant_arm import PlantArm


class DriftingArm(PlantArm):
    """Joint 3 drifts by 0.1 deg per reading."""

    drift_rad = 0.0

    def settle(self, **_: Any) -> bool:
        return False

    def capture(self, samples: int) -> Reading:
        self.drift_rad += np.deg2rad(0.1)
        reading = super().capture(samples)
        return replace(reading, mean_rad=reading.mean_rad + self.drift_rad * (np.arange(7) == 2))


def test_reading_a_drifting_joint_reports_spread_and_limit(make_session):
    procedure = load_procedure("hinge")
    session = make_session(procedure, arm=DriftingArm(procedure, "exact"), connect=True)
    with pytest.raises(GuardError) as error:
        session.reader.read()
    settle = session.procedure.capture.settle
    spread_deg = 0.1 * (settle.window_syncs - 1)
    limit_deg = np.rad2deg(settle.spread_rad(session.model)[2])
    assert f"joint 3 spreads by {spread_deg:.3f} deg" in error.value.happened
    assert f"(limit {limit_deg:.3f} deg)" in error.value.happened


def test_pose_with_a_wrong_sample_is_read_again(make_session, monkeypatch):
    session = make_session(load_procedure("hinge"), connect=True)
    capture, wrong = session.arm.capture, iter([1, 1, 0, 1, 1, 1])

    def glitch(samples: int) -> Reading:
        reading = capture(samples)
        return replace(reading, sd_rad=0.006 * next(wrong) * (np.arange(7) == 2))

    monkeypatch.setattr(session.arm, "capture", glitch)
    assert session.reader.read().sd_rad[2] == 0.0
    with pytest.raises(GuardError, match=r"joint 3 have .* 0\.344 deg \(limit 0\.050 deg\)"):
        session.reader.read()


PATIENCE_S = 60.0
"""Longest delay of a line on a busy machine."""
POSE = {"x_m": 1.0, "y_m": 2.0, "z_m": 3.0, "rx_deg": 0.0, "ry_deg": 0.0, "rz_deg": 90.0}
ENDPOINT = [1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]


def instrument_sending(
    lines: Iterable[dict | str], *, full_pose: bool = True, patience_s: float = 0.0
) -> Instrument:
    """An instrument that sends these lines, then nothing."""
    remaining = iter(lines)

    class Port(CalledLines):
        def line(self, wait_s: float) -> str | None:
            del wait_s
            line = next(remaining, None)
            return json.dumps(line) if isinstance(line, dict) else line

    port = Port(lambda _: "", "tcp:lab:7327")
    return Instrument(port, full_pose=full_pose, patience_s=patience_s)


def test_measurement_is_that_of_its_pose_with_the_required_coordinates():
    lines = [{"pose": "11", **POSE, "x_m": 9.0}, "", {"pose": "12", **POSE}]
    endpoint = instrument_sending(lines, patience_s=60.0).measure("12")
    assert endpoint.tolist() == pytest.approx(ENDPOINT)
    endpoint = instrument_sending([POSE], full_pose=False).measure("1")
    assert endpoint.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "lines",
    [
        [],
        [{"pose": "11", **POSE}],
        [{"x_m": 1, "y_m": 2, "z_m": 3}],
        [{"x_m": 1000, "y_m": 2, "z_m": 3}],
        ["hello"],
    ],
    ids=["silent", "other pose", "no orientation", "out of range", "not JSON"],
)
def test_missing_or_invalid_measurement_is_reported_with_the_pose(lines, approve):
    with pytest.raises(InstrumentError) as error:
        instrument_sending(lines).measure("12")
    approve(str(error.value))


def test_measurements_of_other_poses_time_out():
    instrument = instrument_sending(itertools.repeat({"pose": "11", **POSE}), patience_s=0.05)
    with pytest.raises(
        InstrumentError, match=r"no measurement of pose 12 .* it sent one for pose 11"
    ):
        instrument.measure("12")


def test_late_answer_to_an_earlier_attempt_is_ignored():
    """The first question was cancelled; the arm may have moved since."""
    late = {"pose": "5", **POSE, "x_m": 9.0}
    lines = [None, late, {"pose": "5 attempt 2", **POSE}]
    instrument = instrument_sending(lines, patience_s=60.0)
    with pytest.raises(StopIteration):
        instrument.measure("5", iter([None]).__next__)
    assert instrument.measure("5")[0] == 1.0


def test_lost_target_has_its_own_error_and_waiting_can_be_cancelled():
    with pytest.raises(TargetLostError, match="beam broken"):
        instrument_sending([{"lost": "beam broken"}]).measure("1")
    with pytest.raises(StopIteration):
        instrument_sending([], patience_s=60.0).measure("1", iter(()).__next__)


@pytest.fixture
def tracker():
    """The port of a tracker, the questions that it received, and a function that sets its answer."""
    questions: list[str] = []
    answers = [json.dumps(POSE)]

    def answer(question: str) -> str:
        questions.append(question.strip())
        return answers[-1]

    with serve_tracker(answer, 0) as port:
        yield port, questions, answers.append


def test_tcp_instrument_discards_lines_from_before_the_question(tracker):
    port, questions, set_answer = tracker
    set_answer(json.dumps({**POSE, "x_m": 5.0}) + "\n" + json.dumps({**POSE, "x_m": 7.0}))
    with contextlib.closing(Instrument(TcpLines("127.0.0.1", port), full_pose=True)) as instrument:
        instrument.open()
        first = instrument.measure("1")
        set_answer(json.dumps(POSE))
        second = instrument.measure("2")
    assert (first[0], second[0]) == (5.0, 1.0)
    assert questions == ['{"measure": "1"}', '{"measure": "2"}']


def test_refused_and_closed_connections_are_reported():
    with serve_tracker(lambda _: "x", 0) as port:
        instrument = Instrument(TcpLines("127.0.0.1", port), full_pose=True)
    with pytest.raises(InstrumentError, match="Start the tracker's program"):
        instrument.open()
    with socket.create_server(("127.0.0.1", 0)) as server:
        instrument = Instrument(TcpLines("127.0.0.1", server.getsockname()[1]), full_pose=True)
        instrument.open()
        server.accept()[0].close()
        with pytest.raises(InstrumentError, match="closed the connection"):
            instrument.measure("1")


@contextlib.contextmanager
def repeating(send: Callable[[bytes], object], data: bytes) -> Iterator[None]:
    ended = threading.Event()

    def repeat() -> None:
        with contextlib.suppress(OSError):
            while not ended.is_set():
                send(data)

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextlib.contextmanager
def flooded_tcp(data: bytes) -> Iterator[TcpLines]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = TcpLines("127.0.0.1", server.getsockname()[1])
        port.open()
        client = server.accept()[0]
        with client, repeating(client.sendall, data), contextlib.closing(port):
            yield port


@contextlib.contextmanager
def flooded_stdin(data: bytes) -> Iterator[StdinLines]:
    """Standard input to which a program writes the data without pause."""
    read_end, write_end = os.pipe()
    port = StdinLines(read_end)
    port.open()
    try:
        with os.fdopen(write_end, "wb", buffering=0) as file, repeating(file.write, data):
            yield port
    finally:
        close_after_reader(read_end)


def close_after_reader(descriptor: int) -> None:
    """Close a pipe once the thread that reads its lines has ended."""
    for thread in threading.enumerate():
        if thread.name == "sarcal-lines":
            thread.join(PATIENCE_S)
    os.close(descriptor)


def test_endless_data_without_lines_is_refused():
    with flooded_tcp(b"y" * 65536) as port, pytest.raises(InstrumentError, match="sends no lines"):
        Instrument(port, full_pose=True).measure("1")


def test_occupied_tracker_port_is_reported(tracker):
    with (
        pytest.raises(InstrumentError, match="another program does"),
        serve_tracker(lambda _: "", tracker[0]),
    ):
        pass


def test_growing_file_returns_only_new_complete_rows(tmp_path):
    path = tmp_path / "seen.csv"
    path.write_text("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n5,5,5,0,0,0\n6,6,6,0,0,")
    port = GrowingFile(path)
    port.open()
    port.ask("")
    with path.open("a") as file:
        file.write("0\n1,2,3,0,0,9")
        file.flush()
        # The first row was begun before the question, the second one is incomplete.
        assert port.line(0.0) is None
        assert port.line(0.0) is None
        file.write("0\n")
    assert port.line(0.0) == "1,2,3,0,0,90"
    path.write_text("x_m\n")
    with pytest.raises(InstrumentError, match="has become shorter"):
        port.line(0.0)


def test_carriage_return_in_the_heading_is_refused(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_bytes(b"x_m,y_\rm,z_m\n")
    with pytest.raises(InstrumentError, match=r"the header line of file:.* is not a line of CSV"):
        Instrument(GrowingFile(path), full_pose=False).open()


@pytest.mark.parametrize("text", [None, "x_m,y_m", "x_m,y_m\n"])
def test_file_without_a_valid_heading_is_refused(tmp_path, text, approve):
    path = tmp_path / "seen.csv"
    if text is not None:
        path.write_bytes(text.encode())
    with pytest.raises(InstrumentError) as error:
        Instrument(GrowingFile(path), full_pose=True).open()
    approve(str(error.value))


def test_pipe_folder_device_and_unreadable_file_are_refused(tmp_path):
    """A pipe without a writer would block for ever."""
    pipe = tmp_path / "rows.csv"
    os.mkfifo(pipe)
    not_a_file, descriptors = "is a folder, a pipe or a device, not a file", Path("/proc/self/fd")
    before = len(list(descriptors.iterdir()))
    for place, message in (
        (pipe, not_a_file),
        (tmp_path, not_a_file),
        (Path("/dev/zero"), not_a_file),
        *((place, "cannot be read") for place in ("x\0y", "a" * 5000, "/proc/self/mem")),
        *((place, "cannot be read|there is no such file") for place in ("/proc/x", pipe / "below")),
    ):
        with pytest.raises(InstrumentError, match=message):
            port_of(f"file:{place}").open()
    assert len(list(descriptors.iterdir())) == before, "no file stays open"


def test_file_replaced_by_a_pipe_is_reported(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("x_m,y_m,z_m\n")
    port = GrowingFile(path)
    port.open()
    port.ask("")
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(InstrumentError, match=r"shorter|a pipe"):
        port.line(0.0)


def test_standard_input_returns_lines_until_it_ends():
    with flooded_stdin(b'{"a": 1}\n\xff\n') as port:
        assert {port.line(PATIENCE_S), port.line(PATIENCE_S)} == {'{"a": 1}', "\ufffd"}
    for _ in range(2):
        port.ask("")
        with pytest.raises(InstrumentError, match="standard input ended"):
            port.line(PATIENCE_S)


def test_overlong_line_is_refused():
    read_end, write_end = os.pipe()
    port = StdinLines(read_end)
    port.open()
    with os.fdopen(write_end, "wb") as file:
        file.write(b"x" * (LONGEST - 1) + b"\n" + b"x" * (LONGEST + 1))
    assert len(port.line(PATIENCE_S) or "") == LONGEST - 1
    with pytest.raises(InstrumentError, match="without an end of line"):
        port.line(PATIENCE_S)
    close_after_reader(read_end)


def test_lines_sent_without_pause_are_read_from_a_line_start():
    line = json.dumps(POSE | {"utc": "x" * 300})
    data = (line + "\n").encode() * 300
    with flooded_stdin(data) as port:
        for _ in range(20):
            port.ask("")
            assert [port.line(PATIENCE_S), port.line(PATIENCE_S)] == [line, line]
    with flooded_tcp(data) as port:
        instrument = Instrument(port, full_pose=True)
        for k in range(5):
            assert instrument.measure(str(k)).tolist() == pytest.approx(ENDPOINT)


def test_tracker_refuses_clients_beyond_its_limit(tracker):
    port = tracker[0]
    threads_before = threading.active_count()
    idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(CLIENTS)]
    with contextlib.closing(Instrument(TcpLines("127.0.0.1", port), full_pose=True)) as instrument:
        try:
            for _ in range(3):
                instrument.open()
                with pytest.raises(InstrumentError, match=f"{CLIENTS} programs are connected"):
                    instrument.measure("1")
            # One thread per served client and the instrument's own reader; a refused client gets none.
            assert threading.active_count() <= threads_before + CLIENTS + 1
        finally:
            for client in idle:
                client.close()
        # A closed connection makes room for another client.
        until_s, endpoint = time.monotonic() + PATIENCE_S, None
        while endpoint is None:
            assert time.monotonic() < until_s
            with contextlib.suppress(InstrumentError):
                instrument.open()
                endpoint = instrument.measure("1")


@pytest.mark.parametrize("source", ["", "tcp:lab", "tcp:lab:0", "tcp:lab:99999", "file:", "usb:1"])
def test_instrument_source_is_refused_or_the_name_of_its_port(source):
    with pytest.raises(SessionError, match="Write tcp:HOST:PORT"):
        port_of(source)
    for valid in ("tcp:lab:7327", "file:a.csv", "stdin"):
        assert port_of(valid).name == valid
