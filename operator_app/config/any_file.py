"""Files of any kind, told apart by what they hold, and everything wrong with all of them at once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from hardware.canopen.bus_profile import BusProfile
from operator_app.config.arm_file import parse_arm
from operator_app.config.errors import ConfigError, Problem, only
from operator_app.config.fixture_file import FixtureSpec, parse_fixture
from operator_app.config.json_schemas import FILES, keys_of
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import parse_parameters
from operator_app.config.poses_file import LIMIT_BYTES, LoadedPoses, parse_poses
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.profile_file import parse_profile
from operator_app.config.resources import Resource, expanded, read_limited
from operator_app.config.strict_yaml import load_strict
from solver.chain.arm_model import ArmModel

AnyKind = Literal["arm", "fixture", "procedure", "profile", "parameters", "poses"]
SCHEMA = re.compile(r"^schema\s*:\s*[\"']?sarcal/([a-z]+)/", re.MULTILINE)

Holds = ArmModel | FixtureSpec | Procedure | BusProfile | ParametersDocument | LoadedPoses


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """One file: what kind it is (None: nobody can tell), and what it holds where nothing is wrong with it."""

    source: Resource
    kind: AnyKind | None
    holds: Holds | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Files as read, in the order given, and all that is wrong with them."""

    files: tuple[Looked, ...]
    problems: tuple[Problem, ...]

    def of(self, kind: AnyKind) -> tuple[Looked, ...]:
        """The files of one kind."""
        return tuple(looked for looked in self.files if looked.kind == kind)


def read_any(path: str) -> Resource:
    """Read a file whatever it is; raises ConfigError."""
    where = expanded(path)
    return Resource(
        file=path, folder=where.parent, data=read_limited(where, path, limit=LIMIT_BYTES)
    )


def kind_of(source: Resource) -> AnyKind | None:
    """Tell what kind of file this is: by its ``schema`` line, else by its keys or its header."""
    text = source.data.decode("utf-8", errors="replace")
    kinds = SCHEMA.search(text)
    for kind in FILES:
        if kinds is not None and kinds[1] == kind:
            return kind
    lines = (line.strip() for line in text.lstrip("\ufeff").splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    if re.match(r"[^:,]+,[^:]*$", first):
        return "poses"
    try:
        keys = set(load_strict(source.data, source.file).data)
    except ConfigError:
        return None
    shared = {kind: len(keys & keys_of(kind)) for kind in FILES}
    best = max(shared.values())
    likely = [kind for kind in FILES if shared[kind] == best > 1]
    return likely[0] if len(likely) == 1 else None


@dataclass(slots=True)
class _Reader:
    """Reads one file after the other; arms first, as they say how many joints the others speak of."""

    joints: set[int] = field(default_factory=set)
    problems: dict[Problem, None] = field(default_factory=dict)

    def look(self, source: Resource, kind: AnyKind | None) -> Looked:
        holds: Holds | None = None
        try:
            holds = self._parsed(source, kind)
        except ConfigError as error:
            # A file that a procedure names may be given as well: its problems are told once.
            self.problems |= dict.fromkeys(error.problems)
        if isinstance(holds, ArmModel):
            self.joints.add(holds.joint_count)
        elif isinstance(holds, Procedure):
            self.joints.add(holds.arm.joint_count)
        return Looked(source=source, kind=kind, holds=holds)

    def _parsed(self, source: Resource, kind: AnyKind | None) -> Holds:
        data, file = source.data, source.file
        # Where arms of several sizes are given, nobody can say of which this file speaks.
        joints = next(iter(self.joints)) if len(self.joints) == 1 else None
        match kind:
            case "arm":
                return parse_arm(data, file)
            case "fixture":
                return parse_fixture(data, file)
            case "procedure":
                return parse_procedure(source)
            case "profile":
                return parse_profile(data, file, joints=joints)
            case "parameters":
                return parse_parameters(data, file)
            case "poses":
                return self._of_an_arm(parse_poses(data, file, joint_count=joints), file)
        # What keeps it from being read at all is the better complaint.
        load_strict(data, file)
        kinds = ", ".join(FILES)
        raise only(
            file,
            1,
            None,
            "nobody can tell what kind of file this is",
            f"begin it with `schema: sarcal/KIND/1`, of {kinds}; poses are a CSV file",
        )

    def _of_an_arm(self, loaded: LoadedPoses, file: str) -> LoadedPoses:
        """Refuse poses whose number of joints is that of none of the arms."""
        count = loaded.poses.joint_count
        if self.joints and count not in self.joints:
            known = " and ".join(map(str, sorted(self.joints)))
            text = f"poses of {count} joint{'s' if count != 1 else ''}, the arms have {known}"
            raise only(file, 1, None, text, "is it the right arm?")
        return loaded


ORDER: tuple[AnyKind | None, ...] = (
    "arm",
    "fixture",
    "procedure",
    "profile",
    "parameters",
    "poses",
    None,
)


def look_through(
    sources: Iterable[Resource], known: Mapping[str, AnyKind], missing: Iterable[Problem] = ()
) -> Found:
    """Read files of any kind.

    Parameters
    ----------
    known
        Of some, by name, which kind is wanted.
    missing
        What is wrong with files that are not among these, as they cannot be read at all.
    """
    kinds = [(source, known.get(source.file) or kind_of(source)) for source in sources]
    reader = _Reader(problems=dict.fromkeys(missing))
    looked = {
        k: reader.look(source, kind)
        for k, (source, kind) in sorted(enumerate(kinds), key=lambda item: ORDER.index(item[1][1]))
    }
    return Found(files=tuple(looked[k] for k in range(len(kinds))), problems=tuple(reader.problems))
