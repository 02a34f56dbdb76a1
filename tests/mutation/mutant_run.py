"""Runs tests on a module with other source text than its file.

Every run is a fork of this process, which has imported everything but the packages under test: this takes two
seconds and is done once.
"""

import importlib
import os
import resource
import sys
from collections.abc import Sequence
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


def passed(pid: int) -> bool:
    """Wait for a run, and return whether all its tests passed."""
    return os.waitpid(pid, 0)[1] == 0


def start_tests(root: Path, module: str, source: str, tests: Sequence[str]) -> int:
    """Run tests until one fails, with this source of `module` (a path below `root`); return the process."""
    pid = os.fork()
    if pid:
        return pid
    code = 3
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        name = module.removesuffix(".py").replace("/", ".")
        package, _, own_name = name.rpartition(".")
        mutant = sys.modules[name] = ModuleType(name)
        setattr(importlib.import_module(package), own_name, mutant)
        exec(compile(source, str(root / module), "exec"), mutant.__dict__)  # noqa: S102
        os.chdir(root)
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        code = int(pytest.main([*OPTIONS, *tests]))
    finally:
        os._exit(code)
