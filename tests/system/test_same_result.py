"""The same poses give the same digits with any number of BLAS threads and on any kind of processor."""

import os
import subprocess
import sys
from importlib.metadata import version

import pytest
import yaml

from operator_app.session.store.journal import read_journal

OTHER_MACHINES = (
    {"OPENBLAS_NUM_THREADS": "1"},
    {"OPENBLAS_NUM_THREADS": "8"},
    {"OPENBLAS_CORETYPE": "Nehalem"},
    {"OPENBLAS_CORETYPE": "Haswell"},
)
"""Kernels of other processors add in another order: what another machine would do."""


@pytest.mark.campaign
def test_threads_and_processors_change_no_printed_character(reference_data):
    csv = reference_data / "hinge" / "hinge_rvdt1pct.csv"
    said = {
        subprocess.run(
            [sys.executable, "-m", "operator_app.cli", "solve", str(csv)],
            env=os.environ | other,
            capture_output=True,
            text=True,
            check=False,
        ).stdout
        for other in OTHER_MACHINES
    }
    assert len(said) == 1
    assert "theta_off_7" in said.pop()


def test_journal_and_parameters_say_what_they_were_made_with(reference_data, tmp_path, ends_with):
    csv = reference_data / "hinge" / "hinge_exact.csv"
    ends_with(0, "import", csv, "--sessions", tmp_path)
    (folder,) = tmp_path.iterdir()
    (solved,) = (e.data for e in read_journal(folder).events if e.name == "solved")
    assert solved["made_with"]["numpy"] == version("numpy")
    assert solved["made_with"]["scipy"] == version("scipy")
    ends_with(0, "export", folder, "--sessions", tmp_path)
    written = yaml.safe_load((folder / "parameters.yaml").read_text())["software_version"]
    assert written.startswith(f"{version('sarcal')} (numpy {version('numpy')}, scipy ")
