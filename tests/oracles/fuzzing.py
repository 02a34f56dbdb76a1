"""Inputs that nobody would write, for every parser and for the wire: sound ones changed at random, seed by seed.

An outcome is an answer or one of the errors that `sarcal` turns into words and an exit code; whatever
else comes out is a defect and is left to be raised.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from random import Random

import yaml

from hardware.line_port import CalledLines, GrowingFile
from operator_app.calibration.checks import Checks
from operator_app.calibration.record import RecordError, from_dict, to_dict
from operator_app.calibration.solution import Solution
from operator_app.calibration.solve import calibrate
from operator_app.cli import COMMANDS, main
from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.fixture_file import load_fixture, parse_fixture
from operator_app.config.joint_log import load_joint_log
from operator_app.config.parameters_file import format_parameters, parse_parameters
from operator_app.config.poses_file import load_poses, parse_poses
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.profile_file import parse_profile
from operator_app.config.resources import Resource, resolve
from operator_app.config.urdf import format_urdf, parse_urdf
from operator_app.config.user_settings import parse_settings
from operator_app.exit_codes import EXPECTED_ERRORS
from operator_app.session.folder import read_session
from operator_app.session.instrument import Instrument, port_of
from operator_app.session.journal import JOURNAL_NAME
from operator_app.session.opening import Choices, resume
from operator_app.session.repair import repair
from operator_app.virtual_arms import slots_in
from oracles.controller_fuzzing import ControllerTarget
from oracles.journals import ODD, events, mutated, mutated_journal, written
from oracles.parameter_documents import make_document
from oracles.wire_fuzzing import Target

FULL = (
    b"placement,pose,theta1_deg,theta2_deg,theta3_deg,theta4_deg,theta5_deg,theta6_deg,theta7_deg,"
    b"sd1_deg,sd2_deg,sd3_deg,sd4_deg,sd5_deg,sd6_deg,sd7_deg,samples,utc,note,"
    b"x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n"
    + b"".join(
        b"1,%d,1.5,-2,3,4,5,6,7,0.01,0.01,0,0.01,0.01,0.1,0.1,32,2026-01-02T03:04:05Z,n,0.1,0.2,0.3,1,2,3\n"
        % k
        for k in range(1, 9)
    )
)
"""Every column that a poses file may have."""
DATA = Path(__file__).parents[1] / "data" / "hinge" / "hinge_quantised.csv"
WORDS = (
    b"nan", b".inf", b"-1", b"0", b"1e999", b"1e-300", b"9" * 50, b"~", b"[", b"{", b"]]", b"&a",
    b"*a", b"!!python/object:os.system", b"<<: *a", b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"\r",
    b"\n", b"\t", b",", b";", b'"', b"'", b"#", b":", b": ", b"- ", b"|", b"%YAML 9.9", b"---",
    b"true", b"null", b"\x1b[2J", b"\xe2\x80\xae", b"1,5", b"12:30", b"0x1F", b"()", b"\\u0000",
)  # fmt: skip
ODD_WORDS = (
    "", "-", "--", "-1", "0", "nan", "inf", "1e999", "1e-300", "9" * 40, "\u0663", "\x1b[2J", "a" * 5000,
    "~nosuchuser/x", "/dev/null", "/dev/full", "/proc/self/mem", ".", "..", "/", "\udcff", "x\x00y", "6,7",
    "1,,2", "latest", "hinge", "sarcos_dextrous", "no.csv", "--json", "-c", "{}", "%s", "virtual", "vcan0",
)  # fmt: skip
ENDING = (
    "solve",
    "verify",
    "export",
    "report",
    "compare",
    "session",
    "reset",
    "import",
    "new",
    "check",
)
"""Commands that end by themselves whatever they are given; `ENDLESS` ones are given one word too many."""
ENDLESS = ("run", "plan", "controller", "monitor", "probe")
TAKES_SESSIONS = ("export", "report", "compare", "run", "session", "import")
ARGUMENTS: Mapping[str, tuple[str, ...]] = {
    "solve": (str(DATA), "--arm", "--fixture", "--estimator", "paper", "--unsensed", "--global-start",
              "--length-tolerance", "--rvdt-table", "--json"),
    "verify": (str(DATA), "--poses", "--arm", "--fixture", "--session", "--open-loop", "--json"),
    "export": ("--upload", "--force", "--show", "--output", "--json"),
    "report": ("--output", "--json", "-o"),
    "compare": ("--json", "--remounted"),
    "session": ("list", "show", "repair", "--json"),
    "import": (str(DATA), "--rad", "--deg", "--columns", "1-7", "--arm", "--fixture", "--serial", "--json"),
    "new": ("arm", "fixture", "procedure", "--urdf", "--tip", "--name", "--from", "--kind", "--arm", "--fixture",
            "--hand-point", "--base-point", "--hand-direction", "--tolerance-mm", "ball", "1,2,3", str(DATA)),
    "check": (str(DATA), "--arm", "--fixture", "--procedure", "--json", "README.md"),
    "reset": ("--json", "-i", "-b", "--scenario"),
    "run": ("--poses", "--tracker", "--resume", "--force", "--plan", "--estimator", "--unsensed", "-i", "-b", "--seed"),
    "plan": ("--poses", "--fixture", "--arm", "--seed", "--joints", "--json"),
    "controller": ("--arm", "--state", "--fault", "--fault-joint", "--fault-sync", "-i", "-c", "--seed"),
    "monitor": ("-i", "-c", "-b"),
    "probe": ("-i", "-c", "-b", "--json", "--profile", "--draft"),
}  # fmt: skip
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")


def bytes_changed(raw: bytes, rng: Random) -> bytes:
    """Change a few bytes, words, numbers or lines."""
    data = bytearray(raw)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(9):
            case 0 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 1:
                data[at:at] = rng.choice(WORDS)
            case 2:
                del data[at : at + rng.choice((1, 5, 50, 500))]
            case 3:
                end = at + rng.choice((1, 20, 200))
                data[at:at] = data[at:end]
            case 4:
                del data[at:]
            case 5:
                lines = bytes(data).split(b"\n")
                one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
                lines[one], lines[other] = lines[other], lines[one]
                data = bytearray(b"\n".join(lines))
            case 6:
                data[at : at + 3] = rng.randbytes(3)
            case _:
                numbers = list(NUMBER.finditer(bytes(data)))
                if numbers:
                    found = rng.choice(numbers)
                    data[found.start() : found.end()] = rng.choice(WORDS)
    return bytes(data)


def _in_yaml(raw: bytes, rng: Random) -> bytes:
    """Change what a document says, or how it is written."""
    if rng.random() < 0.5:
        return bytes_changed(raw, rng)
    document = mutated(yaml.safe_load(raw), rng)
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True).encode(
        "utf-8", "surrogatepass"
    )


def _journal_contents(rng: Random, folder: Path) -> None:
    (folder / JOURNAL_NAME).write_bytes(mutated_journal(rng))
    found = read_session(folder)
    if found.state is not None and rng.random() < 0.1:
        resume(str(folder), Choices(), root=folder)
    _raise(found.problem)


def _journal_bytes(rng: Random, folder: Path) -> None:
    (folder / JOURNAL_NAME).write_bytes(bytes_changed(_short_journal(), rng))
    try:
        repaired = repair(folder)
        found = read_session(folder)
        if found.problem or found.state is None:
            raise AssertionError(f"repaired and still unreadable: {found.problem}")
        if repaired.aside is None:
            return
        _raise("repaired")
    finally:
        for path in folder.iterdir():
            path.unlink()


class Refused(Exception):
    """The input was refused in words."""


def _raise(problem: str) -> None:
    if problem:
        raise Refused(problem)


@cache
def _short_journal() -> bytes:
    return written([(name, data) for name, data in events() if name != "opened"])


@cache
def _packaged(kind: str, name: str) -> Resource:
    return resolve(kind, name)  # type: ignore[arg-type]


def _arm(rng: Random, _: Path) -> None:
    name = rng.choice(("sarcos_dextrous", "franka_panda"))
    parse_arm(_in_yaml(_packaged("arm", name).data, rng), "arm.yaml")


def _fixture(rng: Random, _: Path) -> None:
    name = rng.choice(("hinge", "ball", "rigid"))
    parse_fixture(_in_yaml(_packaged("fixture", name).data, rng), "fixture.yaml")


def _procedure_of(name: str) -> Callable[[Random, Path], None]:
    def parse(rng: Random, _: Path) -> None:
        source = _packaged("procedure", name)
        changed = Resource(file="p.yaml", folder=None, data=_in_yaml(source.data, rng))
        parse_procedure(changed)

    return parse


def _profile(rng: Random, _: Path) -> None:
    data = _in_yaml(_packaged("profile", "sarcos").data, rng)
    parse_profile(data, "profile.yaml", joints=rng.choice((7, None)))


def _poses(rng: Random, _: Path) -> None:
    sound = rng.choice((DATA.read_bytes(), FULL))
    parse_poses(bytes_changed(sound, rng), "poses.csv", joint_count=rng.choice((7, None)))


LOGS = (
    b"0.1,0.2,0.3\n" * 6,
    b"# t\nt q1 q2 q3\n1 2 3 4\n",
    b"theta1_deg,theta2_deg,theta3_deg,placement,pose\n1,2,3,1,1\n",
)
COLUMNS = ("", "", "1-3", "2-4", "q1,q2,q3", "x", ",", "1-9999", "0", "3,2,1")


def _joint_log(rng: Random, folder: Path) -> None:
    file = folder / "log.csv"
    file.write_bytes(bytes_changed(rng.choice(LOGS), rng))
    unit = rng.choice(("rad", "deg", None))
    load_joint_log(file, joint_count=3, unit=unit, columns=rng.choice(COLUMNS))  # type: ignore[arg-type]


@cache
def _urdf_file() -> bytes:
    arm = load_arm("franka_panda")
    return format_urdf(arm, arm.table)


def _urdf(rng: Random, _: Path) -> None:
    parse_urdf(bytes_changed(_urdf_file(), rng), "arm.urdf", tip=rng.choice(("", "", "link_3")))


@cache
def _parameters_file() -> bytes:
    return format_parameters(make_document())


def _parameters(rng: Random, _: Path) -> None:
    parse_parameters(_in_yaml(_parameters_file(), rng), "parameters.yaml")


@cache
def _solved() -> Mapping[str, object]:
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    poses = load_poses(DATA, joint_count=arm.joint_count).poses
    solution = calibrate(arm, fixture, poses, estimator="paper")
    found: Mapping[str, object] = json.loads(json.dumps(to_dict(solution)))
    return found


def _record(rng: Random, _: Path) -> None:
    changed = mutated(_solved(), rng)
    if isinstance(changed, dict):
        try:
            from_dict(rng.choice((Solution, Solution, Solution, Checks)), changed)
        except RecordError as error:
            raise Refused(str(error)) from error


_target, _told = Target(), ControllerTarget()


def _wire(rng: Random, _: Path) -> None:
    _target.meddle(rng)


def _controller(rng: Random, _: Path) -> None:
    if _told.tell(rng):
        raise Refused("a node refused object access")


def over() -> None:
    """Let go of the operator and of the controller that still run, if they do."""
    _target.close()
    _told.close()


SETTINGS = (
    b"schema: sarcal/settings/1\ninterface: socketcan\nchannel: can0\nbitrate: 500000\n"
    b"theme: dark\noperator: R. Hand\n"
)


def _settings(rng: Random, _: Path) -> None:
    parse_settings(_in_yaml(SETTINGS, rng), "settings.yaml")


MEASURED = (
    b'{"pose": "12", "x_m": 0.1, "y_m": 0.2, "z_m": 0.3, "rx_deg": 1, "ry_deg": 2, "rz_deg": 3}',
    b'{"pose": "12", "lost": "behind the elbow"}',
    b'{"x_m": 0.1, "y_m": 0.2, "z_m": 0.3, "qw": 1, "qx": 0, "qy": 0, "qz": 0}',
)
HEADING, ROW = b"pose,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n", b"12,0.1,0.2,0.3,1,2,3\n"


def _instrument(rng: Random, folder: Path) -> None:
    """A line of JSON, or a file that grows: the file itself, its heading or a row may be odd."""
    if rng.random() < 0.5:
        said = bytes_changed(rng.choice(MEASURED), rng).decode(errors="replace")
        instrument = Instrument(
            CalledLines(lambda _: said, "a tracker"), full_pose=rng.random() < 0.5, patience_s=0.0
        )
        instrument.open()
        instrument.measure("12")
        return
    file = folder / "rows.csv"
    if rng.random() < 0.2:
        port_of(f"file:{_odd_place(rng, folder, file)}").open()
        return
    file.write_bytes(bytes_changed(HEADING, rng) if rng.random() < 0.5 else HEADING)
    port = _Appended(file, bytes_changed(ROW, rng))
    instrument = Instrument(port, full_pose=rng.random() < 0.5, patience_s=0.0)
    instrument.open()
    instrument.measure("12")


class _Appended(GrowingFile):
    """A file to which a row is added as soon as it is asked for one."""

    def __init__(self, path: Path, row: bytes) -> None:
        super().__init__(path)
        self._file, self._row = path, row

    def ask(self, question: str) -> None:
        super().ask(question)
        with self._file.open("ab") as file:
            file.write(self._row)


def _odd_place(rng: Random, folder: Path, own: Path) -> Path:
    """What is no file, or none that this program may write, often a pipe nobody is at the other end of."""
    match rng.randrange(6):
        case 0 | 1:
            pipe = folder / "pipe"
            if not pipe.exists():
                os.mkfifo(pipe)
            return pipe
        case 2:
            return folder
        case 3:
            return own / "below" / "it"
        case 4:
            return Path(
                rng.choice(("/proc/x", "/proc/self/mem", "/dev/null", "/dev/zero", "/dev/full"))
            )
        case _:
            return Path(rng.choice(("x\x00y", "a" * 5000, "")))


def _slots(rng: Random, folder: Path) -> None:
    """The folder of `controller --state`: another thing in its place, or in the place of what lies in it."""
    if rng.random() < 0.3:
        place = _odd_place(rng, folder, folder / "rows.csv")
        if place not in (folder, Path()):
            slots_in(place)
            return
    state = folder / "state"
    state.mkdir(exist_ok=True)
    try:
        sound = slots_in(state)
        for document in (b"one", b"two")[: rng.randrange(3)]:
            sound.commit(document)
        for name in ("active", "slot_a", "slot_b", "slot_a.new", "active.new"):
            file = state / name
            match rng.randrange(8):
                case 0 if file.exists():
                    file.write_bytes(bytes_changed(file.read_bytes(), rng))
                case 1:
                    file.unlink(missing_ok=True)
                    os.mkfifo(file)
                case 2 if not file.exists():
                    file.mkdir()
        store = slots_in(state)
        active = store.document(store.active)
        if active not in (None, b"one", b"two"):
            raise AssertionError(f"{active!r} was never committed")
        try:
            store.commit(b"three")
        except OSError as error:
            raise Refused(str(error)) from error
    finally:
        shutil.rmtree(state)


def _arguments(rng: Random, folder: Path) -> None:
    """Words that are nearly a command, to the one door that commands have."""
    command = rng.choice((*ENDING, *ENDLESS))
    words = [
        command,
        *(rng.choice(ARGUMENTS[command] + ODD_WORDS) for _ in range(rng.randrange(6))),
    ]
    if rng.random() < 0.5:
        words += [rng.choice(ARGUMENTS[command]), rng.choice(ODD_WORDS)]
    if command in ENDLESS:
        words.append("--no-such-option")
    if rng.random() < 0.2:
        rng.shuffle(words)
        words = words if {*words} & {*COMMANDS} else [command, *words]
    elif command in TAKES_SESSIONS:
        words += ["--sessions", str(folder)]
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            code = main(words)
        except SystemExit as ended:
            code = ended.code
    if code not in (0, 2, 3, 4, 5):
        raise AssertionError(f"exit code {code} for {words}")
    if "\x1b[2J" in said.getvalue():
        raise AssertionError(f"a terminal would obey what {words} says")
    if code != 0:
        raise Refused(said.getvalue())


PARSERS: Mapping[str, tuple[int, Callable[[Random, Path], None]]] = {
    "journal, contents": (20, _journal_contents),
    "journal, bytes, repaired": (6, _journal_bytes),
    "solution in a journal": (4, _record),
    "arm": (4, _arm),
    "fixture": (4, _fixture),
    "bus profile": (3, _profile),
    "procedure": (3, _procedure_of("hinge")),
    "procedure with a plan": (3, _procedure_of("hinge_planned")),
    "poses": (3, _poses),
    "parameters": (3, _parameters),
    "joint log": (3, _joint_log),
    "urdf": (3, _urdf),
    "arguments": (2, _arguments),
    "user settings": (2, _settings),
    "instrument": (3, _instrument),
    "parameter slots": (2, _slots),
    "the wire": (10, _wire),
    "the controller's nodes": (4, _controller),
}
"""What is fuzzed, in these shares."""


def outcome(kind: str, seed: int, folder: Path) -> str:
    """What comes of one input: ``accepted`` or ``refused``; a defect is raised."""
    rng = Random(f"{kind} {seed}")  # noqa: S311 - to be repeated, not to be secret
    try:
        PARSERS[kind][1](rng, folder)
    except (*EXPECTED_ERRORS, Refused):
        return "refused"
    return "accepted"


__all__ = ["ODD", "PARSERS", "outcome", "over"]
