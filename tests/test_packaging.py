"""The environment and the package: pins, plugin entry point, data files, nothing foreign."""

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

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("operator_app", "hardware", "fixtures", "solver")


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _pins() -> dict[str, str]:
    lines = (REPOSITORY / "constraints.txt").read_text().splitlines()
    pairs = (line.split("==") for line in lines if not line.startswith("#"))
    return {_canonical(name): version for name, version in pairs}


def test_constraints_are_exact_pins_and_nothing_else():
    for line in (REPOSITORY / "constraints.txt").read_text().splitlines():
        assert re.fullmatch(r"#[^:/]*|[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.]*", line), line


def test_every_requirement_is_pinned_in_a_version_that_it_admits():
    pins = _pins()
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    pending = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    seen: set[str] = set()
    while pending:
        requirement = Requirement(pending.pop())
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        name = _canonical(requirement.name)
        assert name in pins, f"{requirement} is not pinned"
        assert requirement.specifier.contains(pins[name]), f"{requirement}: {pins[name]}"
        if name not in seen:
            seen.add(name)
            pending += importlib.metadata.requires(name) or []
    assert "fixtures" not in seen
    assert seen <= set(pins)


def test_the_distribution_named_fixtures_is_not_installed():
    with pytest.raises(importlib.metadata.PackageNotFoundError):
        importlib.metadata.distribution("fixtures")


@pytest.mark.parametrize("name", PACKAGES)
def test_our_packages_are_the_ones_imported(name):
    module = importlib.import_module(name)
    assert module.__file__ is not None
    assert Path(module.__file__) == REPOSITORY / name / "__init__.py"


def test_no_package_below_tests():
    assert not list((REPOSITORY / "tests").rglob("__init__.py"))


@pytest.mark.campaign
def test_the_wheel_holds_the_packages_with_their_data_and_nothing_else(tmp_path):
    source = _copy_of_sources(tmp_path / "source")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    built = subprocess.run(
        [*pip, "--wheel-dir", tmp_path, source], capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    held = {n for n in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in n}
    wanted = {
        path.relative_to(source).as_posix()
        for package in PACKAGES
        for path in (source / package).rglob("*")
        if path.suffix in {".py", ".yaml", ".eds", ".tcss", ".css", ".ipynb", ".md", ".svg"}
        or path.name == "py.typed"
    }
    wanted -= {"operator_app/api/__init__.py"}
    # One name for each module: what is imported as `sarcal` is not there as anything else.
    assert held == {name.removeprefix("operator_app/api/") for name in wanted}
    assert "sarcal/__init__.py" in held
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target"]
    subprocess.run([*pip, tmp_path / "site", wheel], check=True)
    assert _calibrated_in(tmp_path / "site") == (tmp_path / "site/sarcal/__init__.py").as_posix()


@pytest.mark.campaign
def test_an_editable_installation_imports_the_sources_under_their_one_name(tmp_path):
    source = _copy_of_sources(tmp_path / "source")
    build = (
        "import sys; from setuptools.build_meta import build_editable; build_editable(sys.argv[1])"
    )
    made = subprocess.run(
        [sys.executable, "-c", build, tmp_path],
        cwd=source,
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    (wheel,) = tmp_path.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target"]
    subprocess.run([*pip, tmp_path / "site", wheel], check=True)
    assert (
        _calibrated_in(tmp_path / "site")
        == (source / "operator_app/api/sarcal/__init__.py").as_posix()
    )


def _calibrated_in(site: Path) -> str:
    """Use the installation in `site` from elsewhere, away from this repository; return what was imported."""
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
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=site, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.strip()


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["fixtures", "solver", "hardware"])
def test_a_foreign_package_of_our_name_is_told_at_start_with_what_to_do(tmp_path, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("raise SystemExit('imported')\n")
    # As pip leaves it.
    record = tmp_path / f"another_{name}-1.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: another-{name}\nVersion: 1.0\n")
    (record / "RECORD").write_text(f"{name}/__init__.py,,\n")
    for start in (
        "from operator_app.cli import main; sys.exit(main(['--version']))",
        "import sarcal",
    ):
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); "
        code += f"sys.path.append({str(REPOSITORY / 'operator_app/api')!r}); {start}"
        ran = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
        )
        assert ran.returncode == (2 if "cli" in start else 1)
        said = ran.stderr.splitlines()[-1]
        assert f"the name '{name}' belongs to another package here" in said
        assert str(tmp_path / name / "__init__.py") in said
        assert f"pip uninstall another-{name}" in said


def test_ones_own_file_of_our_name_is_to_be_renamed_and_nothing_uninstalled(tmp_path):
    own = tmp_path / "solver.py"
    own.write_text("raise SystemExit('imported')\n")
    script = tmp_path / "mine.py"
    script.write_text("import sarcal\n")
    ran = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert ran.returncode == 1
    said = ran.stderr.splitlines()[-1]
    assert f"Python finds {own} before it" in said
    assert "Rename or move it" in said
    assert "uninstall" not in said


def test_a_foreign_package_installed_over_ours_is_told_too(tmp_path):
    source = _copy_of_sources(tmp_path / "source")
    # As PyPI's `fixtures` leaves it: its files in our folder, its __init__.py in place of ours.
    (source / "fixtures/__init__.py").write_text('"""Fixtures provide a way to create state."""\n')
    start = "from operator_app.cli import main; sys.exit(main(['--version']))"
    code = f"import sys; sys.path.insert(0, {str(source)!r}); {start}"
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert ran.returncode == 2
    assert "the name 'fixtures' belongs to another package here" in ran.stderr


def _copy_of_sources(target: Path) -> Path:
    target.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, target)
    for name in PACKAGES:
        shutil.copytree(
            REPOSITORY / name, target / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    return target
