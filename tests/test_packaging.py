"""Environment and distribution: pins, packaged data files, no foreign package under one of our names."""

import importlib
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("operator_app", "hardware", "fixtures", "solver")
START_CLI = "from operator_app.cli import main; sys.exit(main(['--version']))"


def _python(*arguments: object, cwd: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)
    assert result.returncode == code, result.stderr
    return result


def test_constraints_are_exact_pins_of_every_requirement():
    lines = (REPOSITORY / "constraints.txt").read_text().splitlines()
    for line in lines:
        assert re.fullmatch(r"#[^:/]*|[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.]*", line), line
    pairs = (line.split("==") for line in lines if not line.startswith("#"))
    pins = {canonicalize_name(name): version for name, version in pairs}
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    pending = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    required: set[str] = set()
    while pending:
        requirement = Requirement(pending.pop())
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        name = canonicalize_name(requirement.name)
        assert name in pins, f"{requirement} is not pinned"
        assert requirement.specifier.contains(pins[name]), f"{requirement}: {pins[name]}"
        if name not in required:
            required.add(name)
            pending += importlib.metadata.requires(name) or []
    assert "fixtures" not in required


def test_packages_are_imported_from_this_repository():
    for name in PACKAGES:
        assert importlib.import_module(name).__file__ == str(REPOSITORY / name / "__init__.py")


def test_tests_contain_no_package():
    assert not list((REPOSITORY / "tests").rglob("__init__.py"))


@pytest.mark.campaign
def test_wheel_contains_packages_and_data_only(tmp_path):
    source = _copy_sources(tmp_path / "source")
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path)
    _python("-m", "pip", "wheel", *options, source, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    contents = {n for n in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in n}
    expected = {
        path.relative_to(source).as_posix()
        for package in PACKAGES
        for path in (source / package).rglob("*")
        if path.suffix in {".py", ".yaml", ".eds", ".tcss", ".css", ".ipynb", ".md", ".svg"}
        or path.name == "py.typed"
    }
    expected -= {"operator_app/api/__init__.py"}
    # Modules imported as `sarcal` have no second name.
    assert contents == {name.removeprefix("operator_app/api/") for name in expected}
    assert "sarcal/__init__.py" in contents
    assert _use_installed(wheel, tmp_path / "site") == tmp_path / "site/sarcal/__init__.py"


@pytest.mark.campaign
def test_editable_installation_imports_the_sources(tmp_path):
    source = _copy_sources(tmp_path / "source")
    build = "import sys; from setuptools.build_meta import build_editable as b; b(sys.argv[1])"
    _python("-c", build, tmp_path, cwd=source)
    (wheel,) = tmp_path.glob("*.whl")
    expected = source / "operator_app/api/sarcal/__init__.py"
    assert _use_installed(wheel, tmp_path / "site") == expected


def _use_installed(wheel: Path, site: Path) -> Path:
    """Install a wheel and use it away from this repository; return the path of the imported `sarcal`."""
    _python("-m", "pip", "install", "--quiet", "--no-deps", "--target", site, wheel, cwd=REPOSITORY)
    code = f"""
import sys, site
sys.path = [p for p in sys.path if "site-packages" in p or not p.startswith({str(REPOSITORY)!r})]
sys.path = [p for p in sys.path if "__editable__" not in p]
sys.meta_path = [f for f in sys.meta_path if "editable" not in repr(f)]
for name in [n for n in sys.modules if "__editable__" in n]:
    del sys.modules[name]
before = list(sys.path)
site.addsitedir({str(site)!r})
sys.path = [p for p in sys.path if p not in before] + before
import sarcal, operator_app
assert sarcal.load_arm("franka_panda").joint_count == 7
assert sarcal.Result.__module__ == "sarcal.result"
print(sarcal.__file__)
"""
    return Path(_python("-c", code, cwd=site).stdout.strip())


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["fixtures", "solver", "hardware"])
def test_foreign_package_with_our_name_is_reported_at_start(tmp_path, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("raise SystemExit('imported')\n")
    # As pip installs it.
    record = tmp_path / f"another_{name}-1.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: another-{name}\nVersion: 1.0\n")
    (record / "RECORD").write_text(f"{name}/__init__.py,,\n")
    for start, exit_code in ((START_CLI, 2), ("import sarcal", 1)):
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); "
        code += f"sys.path.append({str(REPOSITORY / 'operator_app/api')!r}); {start}"
        message = _python("-c", code, cwd=tmp_path, code=exit_code).stderr.splitlines()[-1]
        assert f"the name '{name}' belongs to another package here" in message
        assert str(tmp_path / name / "__init__.py") in message
        assert f"pip uninstall another-{name}" in message


def test_users_file_with_our_name_is_to_be_renamed(tmp_path):
    module, script = tmp_path / "solver.py", tmp_path / "mine.py"
    module.write_text("raise SystemExit('imported')\n")
    script.write_text("import sarcal\n")
    message = _python(script, cwd=tmp_path, code=1).stderr.splitlines()[-1]
    assert f"Python finds {module} before it" in message
    assert "Rename or move it" in message
    assert "uninstall" not in message


def test_foreign_package_installed_over_ours_is_reported(tmp_path):
    source = _copy_sources(tmp_path / "source")
    # PyPI's `fixtures` puts its files into our folder and replaces our __init__.py.
    (source / "fixtures/__init__.py").write_text('"""Fixtures provide a way to create state."""\n')
    code = f"import sys; sys.path.insert(0, {str(source)!r}); {START_CLI}"
    errors = _python("-c", code, cwd=tmp_path, code=2).stderr
    assert "the name 'fixtures' belongs to another package here" in errors


def _copy_sources(target: Path) -> Path:
    target.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, target)
    for name in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / name, target / name, ignore=ignore)
    return target
