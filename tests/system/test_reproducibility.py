"""The same poses give the same digits with any number of BLAS threads and on any processor."""

import os
import subprocess
import sys
from importlib.metadata import version

import pytest
import yaml

from tests.oracles.journal_events import event_data

ENVIRONMENTS = (
    {"OPENBLAS_NUM_THREADS": "1"},
    {"OPENBLAS_NUM_THREADS": "8"},
    {"OPENBLAS_CORETYPE": "Nehalem"},
    {"OPENBLAS_CORETYPE": "Haswell"},
)
"""BLAS kernels of other processors add in another order."""


@pytest.mark.campaign
def test_blas_threads_and_kernels_change_no_printed_character(reference_data):
    csv = reference_data / "hinge" / "hinge_rvdt1pct.csv"
    outputs = {
        subprocess.run(
            [sys.executable, "-m", "operator_app.cli", "solve", str(csv)],
            env=os.environ | environment,
            capture_output=True,
            text=True,
            check=False,
        ).stdout
        for environment in ENVIRONMENTS
    }
    assert len(outputs) == 1
    assert "theta_off_7" in outputs.pop()


def test_journal_and_parameters_have_software_versions(reference_data, tmp_path, run_command):
    libraries = {name: version(name) for name in ("numpy", "scipy")}
    csv = reference_data / "hinge" / "hinge_exact.csv"
    run_command(0, "import", csv, "--sessions", tmp_path)
    (folder,) = tmp_path.iterdir()
    (solved,) = event_data(folder, "solved")
    assert {name: solved["made_with"][name] for name in libraries} == libraries
    run_command(0, "export", folder, "--sessions", tmp_path)
    software = yaml.safe_load((folder / "parameters.yaml").read_text())["software_version"]
    assert software.startswith(f"{version('sarcal')} (numpy {libraries['numpy']}, scipy ")
