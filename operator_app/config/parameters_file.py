"""The parameters file (``sarcal/parameters/3``; 1 and 2 are read), written and read strictly. Knows no controller."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from operator_app.config.atomic import write_atomically
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.parameters import ParametersDocument
from operator_app.config.resources import YAML_LIMIT_BYTES, expanded, read_limited
from operator_app.config.schema import adapter, is_unlike_any_key, read_model, schema_name
from operator_app.config.yaml_writer import dump_strict

COMMENT = "Written by sarcal. A controller checks it against this schema; edit it only on purpose."
WITHOUT_BETA = "sarcal/parameters/2"
RESULT = "the result"
REMEDY = "this calibration cannot be exported: take more and different poses"
OF_A_NEWER = "a newer sarcal may have written it: read the file with that one, or remove this key"
"""Nobody writes this file by hand, so a key that nothing here is like was not misspelt."""


def parse_parameters(data: bytes, file: str = "parameters") -> ParametersDocument:
    """Read a parameters document from its bytes.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    try:
        return read_model(ParametersDocument, data, kind="parameters", file=file)
    except ConfigError as error:
        raise ConfigError(
            replace(p, remedy=OF_A_NEWER) if is_unlike_any_key(p) else p for p in error.problems
        ) from error


def load_parameters(path: str | Path) -> ParametersDocument:
    """Read a parameters file; raises as `parse_parameters`."""
    where = expanded(path)
    return parse_parameters(read_limited(where, str(path), limit=YAML_LIMIT_BYTES), str(path))


def format_parameters(document: ParametersDocument) -> bytes:
    """Write a document; `parse_parameters` gives back the same one, bit for bit.

    Raises
    ------
    ConfigError
        The schema would refuse it: an iteration ran away to lengths no arm has, a number is not
        finite, a text is empty. What is written goes to a controller, so it is checked here.
    """
    # Of the two sigmas of an entry, the one that it does not have is left out.
    body = adapter(ParametersDocument).dump_python(document, exclude_defaults=True)
    # Without a beta it is what programs of version 2 read.
    name = schema_name("parameters") if document.table.beta_rad.any() else WITHOUT_BETA
    try:
        data = dump_strict({"schema": name, **body}, comment=COMMENT)
    except ValueError as error:
        problem = Problem(file=RESULT, text=str(error), remedy=REMEDY)
        raise ConfigError((problem,)) from error
    try:
        parse_parameters(data, RESULT)
    except ConfigError as error:
        raise ConfigError(replace(p, line=None, remedy=REMEDY) for p in error.problems) from error
    return data


def save_parameters(path: Path, document: ParametersDocument) -> None:
    """Write a parameters file atomically; WriteError when the system refuses, else as above."""
    write_atomically(path, format_parameters(document))
