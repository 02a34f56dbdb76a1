"""The manual's example package, installed without an installer, and its toy arm as a process."""

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from operator_app.cli import main

PROCEDURE = """\
schema: sarcal/procedure/1
name: quick
arm: sarcos_dextrous
fixture: hinge
bus: {interface: virtual}
modes: {position: [1, 5]}
capture:
  poses: 6
  exploration:
    - {joint: 1, from_deg: -30, to_deg: 48}
    - {joint: 5, from_deg: -70, to_deg: 0}
  speed_deg_per_s: 50
  settle: {window_syncs: 5, spread_sigmas: 12, spread_min_deg: 0.01, timeout_syncs: 2000}
  samples_per_pose: 8
  seed: 1
estimator: implicit
acceptance: {scaled_condition_number: 1000}
export: {upload: true}
"""


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
