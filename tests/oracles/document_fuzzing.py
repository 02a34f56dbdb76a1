"""Fuzzing of every file that `sarcal` reads, and of the record of a solution in a journal."""

import json
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from random import Random

import yaml

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import RecordError, from_dict, to_dict
from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.fixture_file import load_fixture, parse_fixture
from operator_app.config.joint_log import load_joint_log
from operator_app.config.parameters_file import format_parameters, parse_parameters
from operator_app.config.poses_file import load_poses, parse_poses
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.profile_file import parse_profile
from operator_app.config.resources import Kind, Resource, resolve
from operator_app.config.urdf_editing import format_urdf
from operator_app.config.urdf_reading import parse_urdf
from operator_app.config.user_settings import parse_settings
from operator_app.session.store.folders import read_session
from operator_app.session.store.journal import JOURNAL_NAME
from operator_app.session.store.journal_repair import repair_journal
from operator_app.session.workflow.opening import Choices, resume
from tests.oracles.journals import events, mutated, mutated_journal, written
from tests.oracles.parameter_documents import make_document

ALL_COLUMNS = (
    b"placement,pose,theta1_deg,theta2_deg,theta3_deg,theta4_deg,theta5_deg,theta6_deg,theta7_deg,"
    b"sd1_deg,sd2_deg,sd3_deg,sd4_deg,sd5_deg,sd6_deg,sd7_deg,samples,utc,note,"
    b"x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n"
    + b"".join(
        b"1,%d,1.5,-2,3,4,5,6,7,0.01,0.01,0,0.01,0.01,0.1,0.1,32,2026-01-02T03:04:05Z,n,0.1,0.2,0.3,1,2,3\n"
        % k
        for k in range(1, 9)
    )
)
"""A poses file with every column."""
DATA = Path(__file__).parents[1] / "data" / "hinge" / "hinge_quantised.csv"
WORDS = (
    b"nan", b".inf", b"-1", b"0", b"1e999", b"1e-300", b"9" * 50, b"~", b"[", b"{", b"]]", b"&a",
    b"*a", b"!!python/object:os.system", b"<<: *a", b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"\r",
    b"\n", b"\t", b",", b";", b'"', b"'", b"#", b":", b": ", b"- ", b"|", b"%YAML 9.9", b"---",
    b"true", b"null", b"\x1b[2J", b"\xe2\x80\xae", b"1,5", b"12:30", b"0x1F", b"()", b"\\u0000",
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")


Parser = Callable[[Random, Path], object]


class Refused(Exception):
    """The input was refused with a message."""


def refuse(problem: str) -> None:
    if problem:
        raise Refused(problem)


def bytes_changed(raw: bytes, rng: Random) -> bytes:
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
                    number = rng.choice(numbers)
                    data[number.start() : number.end()] = rng.choice(WORDS)
    return bytes(data)


def in_yaml(raw: bytes, rng: Random) -> bytes:
    if rng.random() < 0.5:
        return bytes_changed(raw, rng)
    document = mutated(yaml.safe_load(raw), rng)
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True).encode(
        "utf-8", "surrogatepass"
    )


def _journal_contents(rng: Random, folder: Path) -> None:
    (folder / JOURNAL_NAME).write_bytes(mutated_journal(rng))
    session = read_session(folder)
    if session.state is not None and rng.random() < 0.1:
        resume(str(folder), Choices(), root=folder)
    refuse(session.problem)


def _journal_bytes(rng: Random, folder: Path) -> None:
    (folder / JOURNAL_NAME).write_bytes(bytes_changed(_journal_without_sources(), rng))
    try:
        repaired = repair_journal(folder)
        session = read_session(folder)
        if session.problem or session.state is None:
            raise AssertionError(f"unreadable after repair: {session.problem}")
        if repaired.aside is None:
            return
        refuse("repaired")
    finally:
        for path in folder.iterdir():
            path.unlink()


@cache
def _journal_without_sources() -> bytes:
    return written([(name, data) for name, data in events() if name != "opened"])


def _packaged(kind: Kind, *names: str) -> list[bytes]:
    return [resolve(kind, name).data for name in names]


def _yaml(parse: Callable[[bytes], object], *files: bytes) -> Parser:
    """Fuzz a parser of YAML files."""
    return lambda rng, _: parse(in_yaml(rng.choice(files), rng))


def _parse_procedure(data: bytes) -> None:
    parse_procedure(Resource(file="p.yaml", folder=None, data=data))


def _poses(rng: Random, _: Path) -> None:
    data = bytes_changed(rng.choice((DATA.read_bytes(), ALL_COLUMNS)), rng)
    parse_poses(data, "poses.csv", joint_count=rng.choice((7, None)))


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
def _solved() -> Mapping[str, object]:
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    poses = load_poses(DATA, joint_count=arm.joint_count).poses
    solution = calibrate(arm, fixture, poses, estimator="paper")
    record: Mapping[str, object] = json.loads(json.dumps(to_dict(solution)))
    return record


def _record(rng: Random, _: Path) -> None:
    record = mutated(_solved(), rng)
    if isinstance(record, dict):
        try:
            from_dict(rng.choice((Solution, Solution, Solution, Checks)), record)
        except RecordError as error:
            raise Refused(str(error)) from error


SETTINGS = (
    b"schema: sarcal/settings/1\ninterface: socketcan\nchannel: can0\nbitrate: 500000\n"
    b"theme: dark\noperator: R. Hand\n"
)


DOCUMENTS: Mapping[str, Parser] = {
    "journal, contents": _journal_contents,
    "journal, bytes, repaired": _journal_bytes,
    "solution in a journal": _record,
    "arm": _yaml(
        lambda d: parse_arm(d, "a.yaml"), *_packaged("arm", "sarcos_dextrous", "franka_panda")
    ),
    "fixture": _yaml(
        lambda d: parse_fixture(d, "f.yaml"), *_packaged("fixture", "hinge", "ball", "rigid")
    ),
    "bus profile": _yaml(
        lambda d: parse_profile(d, "p.yaml", joints=(7, None)[len(d) % 2]),
        *_packaged("profile", "sarcos"),
    ),
    "procedure": _yaml(_parse_procedure, *_packaged("procedure", "hinge")),
    "procedure with a plan": _yaml(_parse_procedure, *_packaged("procedure", "hinge_planned")),
    "poses": _poses,
    "parameters": _yaml(parse_parameters, format_parameters(make_document())),
    "joint log": _joint_log,
    "urdf": _urdf,
    "user settings": _yaml(lambda d: parse_settings(d, "settings.yaml"), SETTINGS),
}
