"""Runs tests on a module with other source text than its file.

Every run is a fork of this process, which has imported everything but the packages under test: this takes two
seconds and is done once.
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

import can  # noqa: F401 - imported once
import canopen  # noqa: F401
import hypothesis.stateful  # noqa: F401
import numpy as np  # noqa: F401
import pytest

CPU_LIMIT_S = 60
"""A mutant with an endless loop is detected too."""

OPTIONS = (
    *("-x", "-q", "-p", "no:cacheprovider"),
    # No plugins, and so no settings of plugins.
    *("-c", os.devnull, "--rootdir", ".", "--import-mode=importlib", "-o", "pythonpath=."),
    # Modules imported above are not rewritten by pytest.
    *("-W", "error", "-W", "ignore::pytest.PytestAssertRewriteWarning"),
)


class _SourceFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, with the given source."""

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
class MutantRun:
    pid: int

    def passed(self) -> bool:
        return os.waitpid(self.pid, 0)[1] == 0


def start_tests(root: Path, module: str, source: str, tests: Sequence[str]) -> MutantRun:
    """Run tests until one fails, with this source of `module` (a path below `root`)."""
    pid = os.fork()
    if pid:
        return MutantRun(pid)
    code = 3
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        name = module.removesuffix(".py").replace("/", ".")
        sys.meta_path.insert(0, _SourceFinder(name, root / module, source))
        os.chdir(root)
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        code = int(pytest.main([*OPTIONS, *tests]))
    finally:
        os._exit(code)
