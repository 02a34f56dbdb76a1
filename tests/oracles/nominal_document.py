"""The parameters document of the packaged arm and hinge as their files state them."""

from datetime import UTC, datetime

import pytest

from operator_app.config.arm_file import load_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameter_records import (
    CalibratedEntry,
    DocumentWarning,
    Quality,
    TwoFigures,
    WhichArm,
    WhichFixture,
)
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import (
    format_parameters,
    joints_from_table,
    parse_parameters,
    rows_from_table,
)


def document() -> ParametersDocument:
    arm = load_arm("sarcos_dextrous")
    loop = load_fixture("hinge").fixture.model(arm)
    calibrated = tuple(
        CalibratedEntry.of(entry.name, 0.001 * (k + 1)) for k, entry in enumerate(loop.entries)
    )
    return ParametersDocument(
        arm=WhichArm(model=arm.name, serial="SDA-0007"),
        joints=joints_from_table(arm, loop.table, calibrated),
        dh=rows_from_table(loop.table),
        calibrated=calibrated,
        fixture=WhichFixture(name="hinge", kind="hinge"),
        quality=Quality(
            poses=40,
            rank=14,
            scaled_condition_number=33.1,
            sigma_pos_mm=TwoFigures(rms=2.7, as_printed=0.1),
            sigma_ori_mrad=TwoFigures(rms=6.6, as_printed=0.3),
            chi2_per_dof=None,
        ),
        warnings=(DocumentWarning(code="RVDT_LINEARITY", text="joint 6: 2 % of full scale"),),
        estimator="paper",
        pose_set_sha256="0123456789abcdef" * 4,
        software_version="0.3.0",
        utc=datetime(2026, 1, 31, 12, 0, 0, 250000, tzinfo=UTC),
    )


GOOD = format_parameters(document()).decode()


def complaint(good: str, old: str, new: str) -> ConfigError:
    """What is said of a document in which the first `old` stands as `new`."""
    assert old in good
    with pytest.raises(ConfigError) as caught:
        parse_parameters(good.replace(old, new, 1).encode())
    return caught.value
