"""Runs tests on a module whose source is another than its file's. Knows pytest; no mutation.

Every trial is a fork of this process, which has loaded everything that tests need except the packages
under test: what takes two seconds is done once.
"""

import importlib.abc
import importlib.util
import os
import resource
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import can  # noqa: F401 - loaded once
import canopen  # noqa: F401
import hypothesis.stateful  # noqa: F401
import numpy as np  # noqa: F401
import pytest

LONGEST_CPU_S = 60
"""A mutant that runs for ever is noticed too."""

OPTIONS = (
    *("-x", "-q", "-p", "no:cacheprovider"),
    # No plugin, and so none of their settings: these tests are plain ones.
    *("-c", os.devnull, "--rootdir", ".", "--import-mode=importlib", "-o", "pythonpath=."),
    # What is loaded above is not pytest's to rewrite.
    *("-W", "error", "-W", "ignore::pytest.PytestAssertRewriteWarning"),
)


class _Instead(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, with the source it is given."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        if fullname != self._name:
            return None
        return importlib.util.spec_from_file_location(fullname, self._path, loader=self)

    def create_module(self, spec: ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self._source, str(self._path), "exec"), module.__dict__)  # noqa: S102


@dataclass(frozen=True, slots=True)
class Trial:
    """Tests that run in a process of their own."""

    pid: int

    def passed(self) -> bool:
        """Wait for the end; whether all of them passed."""
        return os.waitpid(self.pid, 0)[1] == 0


def begin(root: Path, module: str, source: str, tests: Sequence[str]) -> Trial:
    """Run tests until one fails, `module` (a path below `root`) having that source."""
    pid = os.fork()
    if pid:
        return Trial(pid)
    code = 3
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_CPU_S, LONGEST_CPU_S))
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        name = module.removesuffix(".py").replace("/", ".")
        sys.meta_path.insert(0, _Instead(name, root / module, source))
        os.chdir(root)
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        code = int(pytest.main([*OPTIONS, *tests]))
    finally:
        os._exit(code)


def passes(root: Path, module: str, source: str, tests: Sequence[str]) -> bool:
    """Whether the tests pass on that source."""
    return begin(root, module, source, tests).passed()
