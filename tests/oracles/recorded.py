"""Test data that are computed once and cached below .pytest_cache, shared by workers and runs.

The key is a digest of sources, data and installed versions.
"""

import copyreg
import fcntl
import hashlib
import os
import pickle
import shutil
import sys
import time
from collections.abc import Callable
from functools import cache, wraps
from importlib.metadata import distributions
from pathlib import Path
from types import MappingProxyType
from typing import ParamSpec, TypeVar

ROOT = Path(__file__).resolve().parents[2]
HOME = ROOT / ".pytest_cache" / "recorded"
SOURCES = ("solver", "fixtures", "hardware", "operator_app", "tests/oracles", "tests/data")
KEPT_S = 24 * 3600.0
"""Lifetime of unused records of other sources."""

P, T = ParamSpec("P"), TypeVar("T")


@cache
def _digest() -> str:
    digest = hashlib.sha256(sys.version.encode())
    digest.update(repr(sorted(d.name + d.version for d in distributions())).encode())
    files = (file for folder in SOURCES for file in (ROOT / folder).rglob("*") if file.is_file())
    for file in sorted(f for f in files if "__pycache__" not in f.parts):
        digest.update(f"{file.relative_to(ROOT)}\0{file.stat().st_size}\0".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def cached_folder(make: Callable[[Path], object]) -> Path:
    """Return the folder that `make` fills; copy it before a change."""
    source = Path(sys.modules[make.__module__].__file__ or "").read_bytes()
    home = HOME / f"{_digest()}"
    home.mkdir(parents=True, exist_ok=True)
    os.utime(home)
    name = f"{make.__module__}.{make.__qualname__}-{_hash(source)}"
    folder, done = home / name, home / f"{name}.done"
    with (home / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
            _remove_old(home)
    return folder


def _remove_old(home: Path) -> None:
    for other in home.parent.iterdir():
        if other != home and time.time() - other.stat().st_mtime > KEPT_S:
            shutil.rmtree(other, ignore_errors=True)


def _read_only(mapping: dict[object, object]) -> MappingProxyType[object, object]:
    return MappingProxyType(mapping)


class _Pickler(pickle.Pickler):
    dispatch_table = copyreg.dispatch_table | {MappingProxyType: lambda m: (_read_only, (dict(m),))}


def recorded(make: Callable[P, T]) -> Callable[P, T]:
    """Compute a function's value once; each call returns a copy."""

    @wraps(make)
    def value(*args: P.args, **kwargs: P.kwargs) -> T:
        def write(folder: Path) -> None:
            with (folder / "value").open("wb") as file:
                _Pickler(file).dump(make(*args, **kwargs))

        arguments = _hash(repr((args, sorted(kwargs.items()))).encode())
        write.__module__, write.__qualname__ = make.__module__, f"{make.__qualname__}-{arguments}"
        result: T = pickle.loads((cached_folder(write) / "value").read_bytes())  # noqa: S301 - ours
        return result

    return value
