"""Converts a calibration to plain data for the journal and back without loss, to avoid solving it again.

The dataclasses define the format, so that adding or removing a field needs no change here. Data that do not fit
the dataclasses are refused (`RecordError`); a field with a default may be missing, and an unknown field is ignored.

A dataclass becomes an object of its fields, an array ``{"shape": .., "values": [..]}``, an enum its
name. Doubles are read back bit for bit; those that JSON cannot write are ``"inf"``, ``"-inf"``, ``"nan"``.
"""

import dataclasses
import math
import types
from collections.abc import Mapping
from enum import Enum
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.loops.closure import ClosureModel
from solver.loops.dh import DhLoop
from solver.loops.endpoints import MeasuredClosure, PointClosure
from solver.loops.placements import Placements

VERSION = 1

STORED_TYPES: Mapping[type, tuple[type, ...]] = {
    ClosureModel: (DhLoop, PointClosure, MeasuredClosure, Placements)
}
"""Classes allowed where an interface is declared; the name of the class is stored as ``kind``."""

ARRAYS: Mapping[Any, type] = {FloatArray: np.float64, IntArray: np.int64, BoolArray: np.bool_}
"""Declared types of arrays and their numbers. The hints themselves are compared: since NumPy 2.5, they are aliases."""

T = TypeVar("T")


class RecordError(Exception):
    """The data do not match the current dataclasses: the calibration has to be solved again."""


def to_dict(value: object) -> dict[str, Any]:
    """Return a dataclass (e.g. `Solution` or `Checks`) as data for JSON."""
    return {"version": VERSION, **_encoded_fields(value)}


def from_dict(of: type[T], data: Mapping[str, Any]) -> T:
    """Return the dataclass `of` from the data of `to_dict`; its arrays are read-only.

    Raises `RecordError` if the data have another `VERSION`, or do not match the dataclass.
    """
    try:
        if data["version"] != VERSION:
            raise ValueError(f"version {data['version']} of the record")
        decoded: T = _decoded(of, data)
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise RecordError(f"not a {of.__name__} as this version stores it: {error}") from error
    return decoded


def _encoded_fields(value: object) -> dict[str, Any]:
    return {_key(f): _encoded(getattr(value, f.name)) for f in _stored_fields(type(value))}


def _encoded(value: object) -> Any:
    if dataclasses.is_dataclass(value):
        known = any(type(value) in types for types in STORED_TYPES.values())
        return ({"kind": type(value).__name__} if known else {}) | _encoded_fields(value)
    match value:
        case Enum():
            return value.name
        case np.ndarray():
            return {
                "shape": list(value.shape),
                "values": [_encoded(v) for v in value.ravel().tolist()],
            }
        case np.generic():
            return _encoded(value.item())
        case float():
            return value if math.isfinite(value) else str(value)
        case None | bool() | int() | str():
            return value
        case tuple():
            return [_encoded(v) for v in value]
        case Mapping():
            return {str(k): _encoded(v) for k, v in value.items()}
        case _:
            raise TypeError(f"a record cannot hold a {type(value).__name__}")


def _decoded(hint: Any, data: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if data is None:
            return None
        (hint,) = (a for a in arguments if a is not type(None))
        return _decoded(hint, data)
    if origin is Literal:
        if data not in arguments:
            raise ValueError(f"{data!r} is not one of {arguments}")
        return data
    if (number := ARRAYS.get(hint)) is not None:
        array = np.array([float(v) for v in data["values"]]).reshape(data["shape"])
        array = array.astype(number)
        array.setflags(write=False)
        return array
    if origin is tuple:
        if arguments[1:] == (...,):
            return tuple(_decoded(arguments[0], v) for v in data)
        return tuple(_decoded(a, v) for a, v in zip(arguments, data, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {arguments[0](k): _decoded(arguments[1], v) for k, v in data.items()}
    if hint in STORED_TYPES:
        hint = {kind.__name__: kind for kind in STORED_TYPES[hint]}[data["kind"]]
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        hints = _hints(hint)
        if upgraded := getattr(hint, "upgraded_record", None):
            data = upgraded(data)
        return hint(
            **{
                f.name: _decoded(hints[f.name], data[_key(f)])
                for f in _stored_fields(hint)
                if _key(f) in data
            }
        )
    return hint[data] if issubclass(hint, Enum) else hint(data)


_hints = cache(get_type_hints)


def _key(field: dataclasses.Field[Any]) -> str:
    """Name under which a record has a field: the field's name or, if it was renamed, its name in earlier versions."""
    return str(field.metadata.get("record", field.name))


def _stored_fields(of: type) -> list[dataclasses.Field[Any]]:
    """Fields that are arguments of the constructor; the others follow from them."""
    return [f for f in dataclasses.fields(of) if f.init]
