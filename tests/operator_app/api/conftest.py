"""A calibration by the library."""

import pytest
import sarcal


@pytest.fixture(scope="session")
def result(reference_data):
    """From exact poses in a hinge."""
    poses = reference_data / "hinge" / "hinge_exact.csv"
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=poses)
