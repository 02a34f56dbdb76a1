"""Reads files of any kind, lists the problems of all of them, and makes JSON Schemas."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import TypeAdapter

from hardware.canopen.bus_profile import BusProfile
from operator_app.config.arm_file import ArmFile, parse_arm
from operator_app.config.atomic import write_atomically
from operator_app.config.errors import ConfigError, Problem, WriteError, only
from operator_app.config.fixture_file import MODELS, FixtureSpec, parse_fixture
from operator_app.config.parameters_file import ParametersDocument, parse_parameters
from operator_app.config.poses_file import LoadedPoses, parse_poses
from operator_app.config.procedure import Procedure, ProcedureFile
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.profile_file import ProfileFile, parse_profile
from operator_app.config.resources import Resource
from operator_app.config.schema import VERSIONS, StrictModel, StrictRecord, adapter
from operator_app.config.strict_yaml import load_strict
from solver.chain.arm_model import ArmModel

FileKind = Literal["arm", "fixture", "procedure", "profile", "parameters"]

FILES: dict[FileKind, tuple[type[StrictModel | StrictRecord], ...]] = {
    "arm": (ArmFile,),
    "fixture": tuple(MODELS.values()),
    "procedure": (ProcedureFile,),
    "profile": (ProfileFile,),
    "parameters": (ParametersDocument,),
}


def json_schema(kind: FileKind) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a kind of file, including the key ``schema``."""
    versions = [f"sarcal/{kind}/{version}" for version in VERSIONS.get(kind, (1,))]
    line: dict[str, Any] = {"description": "The first line of the file."}
    line |= {"const": versions[0]} if len(versions) == 1 else {"enum": versions}
    models: list[tuple[Any, Literal["validation"], TypeAdapter[Any]]] = [
        (model, "validation", adapter(model)) for model in FILES[kind]
    ]
    _, schema = TypeAdapter.json_schemas(models)
    choices = []
    for model in FILES[kind]:
        definition = schema["$defs"][model.__name__]
        definition["properties"] = {"schema": line, **definition["properties"]}
        definition["required"] = ["schema", *definition["required"]]
        choices.append({"$ref": f"#/$defs/{model.__name__}"})
    # Descriptions of the keys that the models do not describe.
    text = (files("operator_app") / "data" / "key_meanings.yaml").read_text("utf-8")
    meanings: dict[str, str] = yaml.safe_load(text)[kind]
    for name, model in schema["$defs"].items():
        for key, spec in model.get("properties", {}).items():
            if meaning := meanings.get(f"{name}.{key}", meanings.get(key)):
                spec.setdefault("description", meaning)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"sarcal {kind} file",
        "oneOf": choices,
        "$defs": schema["$defs"],
    }


def _schema_file_name(kind: FileKind) -> str:
    return f"sarcal-{kind}.schema.json"


def schema_line(kind: FileKind) -> str:
    """Return the first comment of a file (without its ``#``), which tells editors where the JSON Schema is."""
    return f"yaml-language-server: $schema={_schema_file_name(kind)}"


def save_with_schema(target: Path, data: bytes, kind: FileKind) -> None:
    """Write the JSON Schema of this kind into the target's folder, then `data` to `target`.

    Raises WriteError if a file cannot be written; a schema file that did not exist before the call is then removed.
    """
    schema, schema_file = json_schema(kind), target.parent / _schema_file_name(kind)
    is_new = not schema_file.exists()
    write_atomically(schema_file, (json.dumps(schema, indent=1) + "\n").encode())
    try:
        write_atomically(target, data)
    except WriteError:
        if is_new:
            schema_file.unlink(missing_ok=True)
        raise


AnyKind = FileKind | Literal["poses"]
SCHEMA_LINE = re.compile(r"^schema\s*:\s*[\"']?sarcal/([a-z]+)/", re.MULTILINE)

C = TypeVar("C")
FileContent = ArmModel | FixtureSpec | Procedure | BusProfile | ParametersDocument | LoadedPoses


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRead:
    """One file: its kind (None if unknown) and its content (None if invalid)."""

    source: Resource
    kind: AnyKind | None
    content: FileContent | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FilesRead:
    """Results for all files, in the order of the arguments, and all their problems."""

    files: tuple[FileRead, ...]
    problems: tuple[Problem, ...]

    def of(self, kind: type[C]) -> list[C]:
        """Return the contents that are of one type."""
        return [read.content for read in self.files if isinstance(read.content, kind)]


def kind_of(source: Resource) -> AnyKind | None:
    """Return the kind of a file from its ``schema`` line, else from its keys or header; None if unknown."""
    text = source.data.decode("utf-8", errors="replace")
    kinds = SCHEMA_LINE.search(text)
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
    shared = {}
    for kind, models in FILES.items():
        known = (adapter(model).json_schema().get("properties", {}) for model in models)
        shared[kind] = len(keys & set[str]().union(*known))
    best = max(shared.values())
    likely = [kind for kind in FILES if shared[kind] == best > 1]
    return likely[0] if len(likely) == 1 else None


def _parsed(source: Resource, kind: AnyKind | None, joints: set[int]) -> FileContent:
    """Return the content of a file, or raise ConfigError.

    `joints`: joint counts of the arms read so far. Poses must have one of these counts, unless there are none.
    """
    data, file = source.data, source.file
    # If the arms differ in their number of joints, the number for this file is not known.
    count = next(iter(joints)) if len(joints) == 1 else None
    match kind:
        case "arm":
            return parse_arm(data, file)
        case "fixture":
            return parse_fixture(data, file)
        case "procedure":
            return parse_procedure(source)
        case "profile":
            return parse_profile(data, file, joints=count)
        case "parameters":
            return parse_parameters(data, file)
        case "poses":
            loaded = parse_poses(data, file, joint_count=count)
            joint_count = loaded.poses.joint_count
            if joints and joint_count not in joints:
                known = " and ".join(map(str, sorted(joints)))
                text = f"poses of {joint_count} joint{'s' if joint_count != 1 else ''}, the arms have {known}"
                raise only(file, text, "is it the right arm?", line=1)
            return loaded
    # If the file is not valid YAML, report that instead.
    load_strict(data, file)
    kinds = ", ".join(FILES)
    remedy = f"begin it with `schema: sarcal/KIND/1`, KIND one of {kinds}; poses are a CSV file"
    raise only(file, "the kind of this file cannot be recognised", remedy, line=1)


ORDER: tuple[AnyKind | None, ...] = (*FILES, "poses", None)
"""Arms are read first, since they define the number of joints in the other files."""


def read_files(
    sources: Iterable[tuple[Resource, AnyKind | None]], missing: Iterable[Problem]
) -> FilesRead:
    """Read files, each with its expected kind, or None if the kind is to be determined from the content.

    `missing`: problems of further files that cannot be read at all.
    """
    kinds = [(source, kind or kind_of(source)) for source, kind in sources]
    # A file named by a procedure may also be an argument: its problems are reported once.
    problems, joints, read = dict.fromkeys(missing), set[int](), dict[int, FileRead]()
    for k, (source, kind) in sorted(enumerate(kinds), key=lambda item: ORDER.index(item[1][1])):
        content: FileContent | None = None
        try:
            content = _parsed(source, kind, joints)
        except ConfigError as error:
            problems |= dict.fromkeys(error.problems)
        if isinstance(content, ArmModel):
            joints.add(content.joint_count)
        elif isinstance(content, Procedure):
            joints.add(content.arm.joint_count)
        read[k] = FileRead(source=source, kind=kind, content=content)
    return FilesRead(files=tuple(read[k] for k in range(len(kinds))), problems=tuple(problems))
