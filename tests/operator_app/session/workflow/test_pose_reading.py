"""What a reading is refused for, on an arm that a test brings."""

import contextlib
import json
import os
import socket
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

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


class Creeping(PlantArm):
    """Joint 3 creeps on, by a tenth of a degree a reading."""

    crept_rad = 0.0

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        return False

    def capture(self, samples: int) -> Reading:
        self.crept_rad += np.deg2rad(0.1)
        reading = super().capture(samples)
        return replace(reading, mean_rad=reading.mean_rad + self.crept_rad * (np.arange(7) == 2))


def test_of_an_arm_that_does_not_come_to_rest_joint_spread_and_limit_are_said(make_session):
    procedure = load_procedure("hinge")
    session = make_session(procedure, arm=Creeping(procedure, "exact"), connect=True)
    with pytest.raises(GuardError) as refused:
        session.read()
    said = refused.value.happened
    window = session.procedure.capture.settle.window_syncs
    spread_deg = 0.1 * (window - 1)
    assert f"joint 3 spreads by {spread_deg:.3f} deg" in said
    limit_rad = session.procedure.capture.settle.spread_rad(session.model)[2]
    assert f"(limit {np.rad2deg(limit_rad):.3f} deg)" in said


POSE = {"x_m": 1.0, "y_m": 2.0, "z_m": 3.0, "rx_deg": 0.0, "ry_deg": 0.0, "rz_deg": 90.0}
TURNED = [1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]


def says(*lines: dict | str, full_pose: bool = True, patience_s: float = 0.0) -> Instrument:
    """An instrument that answers any question with these lines, then is silent."""

    class Port(CalledLines):
        def ask(self, question: str) -> None:
            self.left = [line if isinstance(line, str) else json.dumps(line) for line in lines]

        def line(self, wait_s: float) -> str | None:
            del wait_s
            return self.left.pop(0) if self.left else None

    port = Port(lambda _: "", "tcp:lab:7327")
    return Instrument(port, full_pose=full_pose, patience_s=patience_s)


def test_a_measurement_of_another_pose_is_not_taken_for_this_one():
    lines = ({"pose": "11", **POSE, "x_m": 9.0}, "", {"pose": "12", **POSE})
    found = says(*lines, patience_s=60.0).measure("12")
    assert found is not None
    assert found.tolist() == pytest.approx(TURNED)


@pytest.mark.parametrize(
    "lines",
    [
        [],
        [{"pose": "11", **POSE}],
        [{"x_m": 1, "y_m": 2, "z_m": 3}],
        [{"x_m": 1000, "y_m": 2, "z_m": 3}],
        ["hello"],
    ],
)
def test_silence_and_what_is_missing_are_said_with_the_pose(lines, approve):
    with pytest.raises(InstrumentError) as caught:
        says(*lines).measure("12")
    approve(str(caught.value))


def test_one_that_never_stops_speaking_of_other_poses_measures_nothing_either():
    class Streaming(CalledLines):
        def line(self, wait_s: float) -> str | None:
            del wait_s
            return json.dumps({"pose": "11", **POSE})

    instrument = Instrument(Streaming(lambda _: "", "tcp:lab:1"), full_pose=True, patience_s=0.05)
    with pytest.raises(
        InstrumentError, match=r"no measurement of pose 12 .* it sent one for pose 11"
    ):
        instrument.measure("12")


def test_where_positions_are_wanted_a_turn_is_left_out():
    found = says(POSE, full_pose=False).measure("1")
    assert found is not None
    assert found.tolist() == [1.0, 2.0, 3.0]


def test_a_lost_target_is_no_broken_instrument_and_the_operator_may_end_the_waiting():
    with pytest.raises(TargetLostError, match="beam broken"):
        says({"lost": "beam broken"}).measure("1")
    assert says(patience_s=60.0).measure("1", lambda: True) is None


@pytest.fixture
def served():
    """A port, the questions that came to it, and what sets its answer."""
    asked: list[str] = []
    answer = [json.dumps(POSE)]

    def answered(question: str) -> str:
        asked.append(question.strip())
        return answer[0]

    with serve_tracker(answered, 0) as port:
        yield port, asked, lambda text: answer.__setitem__(0, text)


def test_over_tcp_it_is_asked_and_what_came_before_is_forgotten(served):
    port, asked, answer = served
    instrument = Instrument(TcpLines("127.0.0.1", port), full_pose=True)
    instrument.open()
    # Two lines for one question: the second one is of a time before the next.
    answer(json.dumps({**POSE, "x_m": 5.0}) + "\n" + json.dumps({**POSE, "x_m": 7.0}))
    first = instrument.measure("1")
    answer(json.dumps(POSE))
    second = instrument.measure("2")
    instrument.close()
    assert first is not None
    assert second is not None
    assert (first[0], second[0]) == (5.0, 1.0)
    assert asked == ['{"measure": "1"}', '{"measure": "2"}']


def test_nobody_there_and_somebody_gone_are_said_with_the_remedy():
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
def flooded(data: bytes) -> Iterator[TcpLines]:
    """A port, open, at whose other end a program sends without pause until it is closed."""
    ended = threading.Event()

    def flood(server: socket.socket) -> None:
        with contextlib.suppress(OSError), server.accept()[0] as client:
            while not ended.is_set():
                client.sendall(data)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=flood, args=(server,))
        thread.start()
        port = TcpLines("127.0.0.1", server.getsockname()[1])
        port.open()
        try:
            yield port
        finally:
            ended.set()
            port.close()
            thread.join()


def test_one_that_sends_without_end_is_said_and_fills_no_memory():
    with flooded(b"y" * 65536) as port, pytest.raises(InstrumentError, match="sends no lines"):
        Instrument(port, full_pose=True).measure("1")


def test_a_port_that_is_taken_is_said_with_another(served):
    with (
        pytest.raises(InstrumentError, match="another program does"),
        serve_tracker(lambda _: "", served[0]),
    ):
        pass


def test_of_a_file_that_grows_only_new_whole_rows_count(tmp_path):
    path = tmp_path / "seen.csv"
    path.write_text("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n5,5,5,0,0,0\n6,6,6,0,0,")
    port = GrowingFile(path)
    instrument = Instrument(port, full_pose=True)
    instrument.open()
    port.ask("")
    with path.open("a") as file:
        file.write("0\n1,2,3,0,0,9")
        file.flush()
        # The row that was half written when it was asked is of before; the new one is not whole.
        assert port.line(0.0) is None
        assert port.line(0.0) is None
        file.write("0\n")
    assert port.line(0.0) == "1,2,3,0,0,90"
    path.write_text("x_m\n")
    with pytest.raises(InstrumentError, match="has become shorter"):
        port.line(0.0)


@pytest.mark.parametrize("text", [None, "x_m,y_m", "x_m,y_m\n"])
def test_a_file_without_a_heading_is_refused_at_once(tmp_path, text, approve):
    path = tmp_path / "seen.csv"
    if text is not None:
        path.write_bytes(text.encode())
    with pytest.raises(InstrumentError) as refused:
        Instrument(GrowingFile(path), full_pose=True).open()
    approve(str(refused.value))


def test_a_pipe_a_folder_and_a_device_are_no_file_that_grows(tmp_path):
    """A pipe would be waited for without end: who writes to it may never come."""
    pipe = tmp_path / "rows.csv"
    os.mkfifo(pipe)
    for place in (pipe, tmp_path, Path("/dev/zero")):
        with pytest.raises(InstrumentError, match="is a folder, a pipe or a device, not a file"):
            port_of(f"file:{place}").open()
    with pytest.raises(InstrumentError, match="cannot be read"):
        port_of("file:x\0y").open()
    # A file by its kind, whose bytes nobody can have.
    with pytest.raises(InstrumentError, match="cannot be read"):
        port_of("file:/proc/self/mem").open()


def test_a_file_that_becomes_a_pipe_on_the_way_is_said(tmp_path):
    file = tmp_path / "rows.csv"
    file.write_text("x_m,y_m,z_m\n")
    port = GrowingFile(file)
    port.open()
    port.ask("")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(InstrumentError, match=r"shorter|a pipe"):
        port.line(0.0)


def test_a_carriage_return_in_a_line_is_said(tmp_path):
    file = tmp_path / "rows.csv"
    file.write_bytes(b"x_m,y_\rm,z_m\n")
    with pytest.raises(InstrumentError, match=r"the heading of file:.* is not a line of CSV"):
        Instrument(GrowingFile(file), full_pose=False).open()


def read_to_the_end(descriptor: int) -> None:
    """Wait for the reader of lines; only then may another have the descriptor."""
    for thread in threading.enumerate():
        if thread.name == "sarcal-lines":
            thread.join(5.0)
    os.close(descriptor)


@contextlib.contextmanager
def sent(data: bytes) -> Iterator[StdinLines]:
    """Standard input into which a tracker has begun to write without pause, until it is closed."""
    here, there = os.pipe()
    ended = threading.Event()

    def write() -> None:
        with contextlib.suppress(OSError), os.fdopen(there, "wb", buffering=0) as file:
            while not ended.is_set():
                file.write(data)

    thread = threading.Thread(target=write)
    thread.start()
    port = StdinLines(here)
    port.open()
    try:
        yield port
    finally:
        ended.set()
        thread.join()
        read_to_the_end(here)


def test_standard_input_gives_lines_until_it_ends():
    with sent(b'{"a": 1}\n\xff\n') as port:
        assert {port.line(5.0), port.line(5.0)} == {'{"a": 1}', "\ufffd"}
    for _ in range(2):
        port.ask("")
        with pytest.raises(InstrumentError, match="standard input ended"):
            port.line(5.0)


def test_a_line_without_end_is_refused():
    here, there = os.pipe()
    port = StdinLines(here)
    port.open()
    with os.fdopen(there, "wb") as file:
        file.write(b"x" * (LONGEST - 1) + b"\n" + b"x" * (LONGEST + 1))
    assert len(port.line(5.0) or "") == LONGEST - 1
    with pytest.raises(InstrumentError, match="without an end of line"):
        port.line(5.0)
    read_to_the_end(here)


def test_one_that_sends_whole_lines_without_pause_is_understood_and_starts_with_a_whole_one():
    line = json.dumps(POSE | {"note": "x" * 300})[:-1].replace(', "note', ', "utc') + "}"
    with sent((line + "\n").encode() * 300) as port:
        for _ in range(20):
            port.ask("")
            assert [port.line(5.0), port.line(5.0)] == [line, line]

    with flooded((line + "\n").encode() * 300) as flood:
        instrument = Instrument(flood, full_pose=True)
        for k in range(5):
            found = instrument.measure(str(k))
            assert found is not None
            assert found.tolist() == pytest.approx(TURNED)


def test_more_programs_than_a_tracker_serves_are_refused_in_words(served):
    port = served[0]
    before = threading.active_count()
    idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(CLIENTS)]
    with contextlib.closing(Instrument(TcpLines("127.0.0.1", port), full_pose=True)) as instrument:
        try:
            for _ in range(3):
                instrument.open()
                with pytest.raises(InstrumentError, match=f"{CLIENTS} programs are connected"):
                    instrument.measure("1")
            # One for each place, and the instrument's own reader: who is refused gets none.
            assert threading.active_count() <= before + CLIENTS + 1
        finally:
            for one in idle:
                one.close()
        # A place that was left is another's.
        for _ in range(200):
            with contextlib.suppress(InstrumentError):
                instrument.open()
                assert instrument.measure("1") is not None
                break
        else:
            pytest.fail("no place was given back")


@pytest.mark.parametrize("source", ["", "tcp:lab", "tcp:lab:0", "tcp:lab:99999", "file:", "usb:1"])
def test_what_names_no_port_is_refused_with_those_there_are(source):
    with pytest.raises(SessionError, match="Write tcp:HOST:PORT"):
        port_of(source)


def test_ports_are_named_in_the_words_they_were_asked_for():
    for source in ("tcp:lab:7327", "file:a.csv", "stdin"):
        assert port_of(source).name == source
