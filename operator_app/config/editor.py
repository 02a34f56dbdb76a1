"""What an editor needs to help with a YAML file of ours: its JSON Schema beside it, and the line that says so.

Knows no kind in particular.
"""

from __future__ import annotations

import json
from pathlib import Path

from operator_app.config.atomic import write_atomically
from operator_app.config.json_schemas import FileKind, json_schema


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
