"""Modules that each command loads: start-up time is imports, counted here instead of timed."""

import json
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import pytest

HINGE = Path(__file__).parents[1] / "data/hinge/hinge_quantised.csv"
ARM_IN_FIXTURE = ("--arm", "sarcos_dextrous", "--fixture", "hinge")
PRINT_LOADED = """
import contextlib, io, json, sys
from operator_app.cli import main
sys.argv[0] = "sarcal"
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main()
print(json.dumps(sorted(sys.modules)))
"""
BUS = ("can", "canopen", "hardware.control", "hardware.buses", "operator_app.session.ui", "textual")
SESSION = ("operator_app.session.workflow.session", "operator_app.session.safety")
SOLVER = ("scipy", "operator_app.calibration.calibrate", "operator_app.report.facts")


def modules_loaded(code: str, *arguments: str) -> list[str]:
    process = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
    )
    modules: list[str] = json.loads(process.stdout.splitlines()[-1])
    return modules


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    root = tmp_path_factory.mktemp("sessions")
    modules_loaded(PRINT_LOADED, "import", str(HINGE), *ARM_IN_FIXTURE, "--sessions", str(root))
    return next(root.iterdir())


@pytest.mark.parametrize(
    ("command", "limit", "not_needed"),
    [
        (("--version",), 195, (*BUS, *SESSION, *SOLVER, "numpy", "pydantic", "yaml")),
        (("session", "list"), 310, (*BUS, *SESSION, *SOLVER, "pydantic")),
        (("solve", str(HINGE), *ARM_IN_FIXTURE), 730, (*BUS, *SESSION, "scipy.spatial")),
        (("report",), 740, (*BUS, *SESSION)),
        (("export",), 590, (*BUS, *SESSION, "scipy.spatial")),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) and len(value) < 9 else None,
)
def test_command_loads_only_what_it_needs(command, limit, not_needed, session):
    arguments = {
        "session": ("--sessions", str(session.parent)),
        "report": (str(session),),
        "export": (str(session),),
    }.get(command[0], ())
    modules = modules_loaded(PRINT_LOADED, *command, *arguments)
    unneeded = [m for m in modules for name in not_needed if m == name or m.startswith(f"{name}.")]
    assert not unneeded
    assert len(modules) <= limit


def test_importing_the_library_loads_no_numerics():
    modules = modules_loaded("import sarcal, json, sys; print(json.dumps(sorted(sys.modules)))")
    assert not {"numpy", "scipy", "pydantic", "can"} & set(modules)


def test_public_names_are_importable():
    import sarcal

    namespace: dict[str, object] = {}
    exec("from sarcal import *", namespace)  # noqa: S102 - a star import inside a function is no syntax
    assert set(sarcal.__all__) <= set(namespace)
    assert all(getattr(sarcal, name).__name__ == name for name in sarcal.__all__)
    assert {name for name in sarcal.__all__ if name.islower()} <= set(dir(sarcal))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = sarcal.no_such_name


def test_help_on_the_library_is_short_and_complete():
    import sarcal

    text = pydoc.render_doc(sarcal, renderer=pydoc.plaintext)
    # Python 3.13 and later fold signatures.
    assert re.sub(r"\(\n {8}.*?\n {4}\)", "()", text, flags=re.DOTALL).count("\n") < 350
    first_screens = text.split("PACKAGE CONTENTS")[0]
    assert [name for name in sarcal.__all__ if not re.search(rf"\b{name}\b", first_screens)] == []
