"""JSON Schemas of our YAML files, from the models that read them: for editors and programs that write such files."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import TypeAdapter

from operator_app.config.arm_file import ArmFile
from operator_app.config.atomic import write_atomically
from operator_app.config.fixture_file import MODELS
from operator_app.config.parameters import ParametersDocument
from operator_app.config.procedure import ProcedureFile
from operator_app.config.profile import ProfileFile
from operator_app.config.schema import VERSIONS, StrictModel, StrictRecord, adapter

FileKind = Literal["arm", "fixture", "procedure", "profile", "parameters"]

FILES: dict[FileKind, tuple[type[StrictModel | StrictRecord], ...]] = {
    "arm": (ArmFile,),
    "fixture": tuple(MODELS.values()),
    "procedure": (ProcedureFile,),
    "profile": (ProfileFile,),
    "parameters": (ParametersDocument,),
}
"""Models of the whole file of each kind."""


def keys_of(kind: FileKind) -> frozenset[str]:
    """Return the keys that a file of a kind may have at its top, beside ``schema``."""
    whole = (adapter(model).json_schema() for model in FILES[kind])
    return frozenset(key for model in whole for key in model.get("properties", ()))


def json_schema(kind: FileKind) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a kind of file, with its ``schema`` line."""
    versions = [f"sarcal/{kind}/{version}" for version in VERSIONS.get(kind, (1,))]
    line: dict[str, Any] = {"description": "The first line of the file."}
    line |= {"const": versions[0]} if len(versions) == 1 else {"enum": versions}
    models: list[tuple[Any, Literal["validation"], TypeAdapter[Any]]] = [
        (model, "validation", adapter(model)) for model in FILES[kind]
    ]
    _, found = TypeAdapter.json_schemas(models)
    choices = []
    for model in FILES[kind]:
        whole = found["$defs"][model.__name__]
        whole["properties"] = {"schema": line, **whole["properties"]}
        whole["required"] = ["schema", *whole["required"]]
        choices.append({"$ref": f"#/$defs/{model.__name__}"})
    meanings = _meanings()[kind]
    for name, model in found["$defs"].items():
        for key, spec in model.get("properties", {}).items():
            meaning = meanings.get(f"{name}.{key}", meanings.get(key))
            if meaning:
                spec.setdefault("description", meaning)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"sarcal {kind} file",
        "oneOf": choices,
        "$defs": found["$defs"],
    }


@cache
def _meanings() -> dict[str, dict[str, str]]:
    """Return what keys mean, by kind of file, as far as their models do not say it."""
    text = (files("operator_app") / "data" / "key_meanings.yaml").read_text("utf-8")
    found: dict[str, dict[str, str]] = yaml.safe_load(text)
    return found


def schema_name(kind: FileKind) -> str:
    """Return the name of the JSON Schema that stands beside files of a kind."""
    return f"sarcal-{kind}.schema.json"


def schema_line(kind: FileKind) -> str:
    """Return the comment that editors look for at the top of a file, without its ``#``."""
    return f"yaml-language-server: $schema={schema_name(kind)}"


def save_with_schema(target: Path, data: bytes, kind: FileKind) -> None:
    """Write a file, and beside it the JSON Schema that its first line names; raises WriteError."""
    schema = json.dumps(json_schema(kind), indent=1) + "\n"
    write_atomically(target, data)
    write_atomically(target.parent / schema_name(kind), schema.encode())
