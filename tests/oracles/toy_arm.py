"""The manual's example package, installed without an installer, and its toy arm as a process."""

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from operator_app.cli import main
from operator_app.config.resources import resolve

PROCEDURE = resolve("procedure", "hinge").data.decode()
"""The packaged procedure, with few and quick poses."""
for old, new in (
    ("name: hinge", "name: quick"),
    ("poses: 40", "poses: 6"),
    ("speed_deg_per_s: 20", "speed_deg_per_s: 50"),
    ("window_syncs: 20, spread_sigmas: 8", "window_syncs: 5, spread_sigmas: 12"),
    ("0.002, timeout_syncs: 1000", "0.01, timeout_syncs: 2000"),
    ("pose: 32", "pose: 8"),
    ("number: 100", "number: 1000"),
):
    assert old in PROCEDURE
    PROCEDURE = PROCEDURE.replace(old, new)


def package(folder: Path) -> Path:
    """Write the page's files to `folder`, and return a folder with the installed package."""
    assert main(["help", "outside-arm", "--files", str(folder)]) == 0
    target = folder.with_name(folder.name + "-installed")
    project = tomllib.loads((folder / "pyproject.toml").read_text())
    name = project["project"]["name"]
    info = target / f"{name.replace('-', '_')}-{project['project']['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
    entry_points = project["project"]["entry-points"]["sarcal.arm"]
    lines = [f"{key} = {value}" for key, value in entry_points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[sarcal.arm]", *lines, ""]))
    for module in project["tool"]["setuptools"]["py-modules"]:
        (target / f"{module}.py").write_text((folder / f"{module}.py").read_text())
    return target


@dataclass(frozen=True)
class Toy:
    """The toy's channel, and its process."""

    channel: str
    process: subprocess.Popen[str]

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()


@contextmanager
def toy(folder: Path, *options: str) -> Iterator[Toy]:
    """Run the page's toy at 1000 Hz."""
    words = [sys.executable, str(folder / "toy_arm.py"), "--port", "0", "--rate", "1000", *options]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            first_line = process.stdout.readline()
            assert first_line.startswith("toy arm at "), first_line
            yield Toy(channel=first_line.removeprefix("toy arm at ").strip(), process=process)
        finally:
            process.kill()
