"""Parameter documents of a hinge calibration, without an estimator."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from datetime import UTC, datetime

from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameter_records import (
    CalibratedEntry,
    DhRow,
    DocumentWarning,
    JointParameters,
    Quality,
    TwoFigures,
    WhichArm,
    WhichFixture,
)
from operator_app.config.parameters_file import (
    ParametersDocument,
    format_parameters,
    joints_from_table,
    parse_parameters,
    rows_from_table,
)

VALUES: Mapping[str, float] = {
    "theta_off_1": 9.9, "theta_off_2": -122.8, "theta_off_3": -21.1, "theta_off_4": -9.2,
    "theta_off_5": 27.1, "theta_off_6": 116.3, "theta_off_7": 89.3, "a_0": 0.202, "s_0": 0.014,
    "alpha_0": -38.5, "s_1": 0.273, "a_7": -0.101, "s_7": 0.038, "alpha_7": 99.8,
}  # fmt: skip
"""Table 2 of the paper, deg and m: the identified parameters."""

CONSTANTS: Mapping[str, float] = {
    "alpha_1": 90.0, "alpha_2": -90.0, "alpha_3": 90.0, "alpha_4": -90.0, "alpha_5": 90.0,
    "alpha_6": -90.0, "s_3": 0.355, "s_5": 0.32,
}  # fmt: skip

SIGMA_DEG = 1e-3
SIGMA_M = 1e-5


def is_angle(name: str) -> bool:
    return name.startswith(("theta_off_", "alpha_"))


def make_document(
    changes: Mapping[str, float] | None = None,
    *,
    values: Mapping[str, float] | None = None,
    nominal: Mapping[str, float] | None = None,
    without: Collection[str] = (),
    sigma: float = 1.0,
    chi2_per_dof: float | None = 1.0,
    poses: str = "a",
) -> ParametersDocument:
    """Build a document.

    `changes` are added to the values, deg and m; `values` and `nominal` replace those of `VALUES` and `CONSTANTS`;
    `without` are entries that were not calibrated; `sigma` is in units of `SIGMA_DEG` and `SIGMA_M`; `poses` is one
    hexadecimal digit for the pose set.
    """
    table = {**CONSTANTS, **(nominal or {}), **VALUES, **(values or {})}
    for name, change in (changes or {}).items():
        table[name] += change
    calibrated = tuple(
        CalibratedEntry.of(name, sigma * (SIGMA_DEG if is_angle(name) else SIGMA_M))
        for name in VALUES
        if name not in without
    )
    sigma_of = {entry.entry: entry.sigma for entry in calibrated}
    joints = tuple(
        JointParameters(
            joint=j,
            theta_off_deg=table[f"theta_off_{j}"],
            sigma_deg=sigma_of.get(f"theta_off_{j}"),
            home_offset_counts=0,
        )
        for j in range(1, 8)
    )
    return ParametersDocument(
        arm=WhichArm(model="sarcos_dextrous", serial="SDA-0001"),
        joints=joints,
        dh=tuple(
            DhRow(
                row=row,
                theta_off_deg=table.get(f"theta_off_{row}", 0.0),
                s_m=table.get(f"s_{row}", 0.0),
                a_m=table.get(f"a_{row}", 0.0),
                alpha_deg=table.get(f"alpha_{row}", 0.0),
            )
            for row in range(8)
        ),
        calibrated=calibrated,
        fixture=WhichFixture(name="hinge", kind="hinge"),
        quality=Quality(
            poses=40,
            rank=len(calibrated),
            scaled_condition_number=33.0,
            sigma_pos_mm=TwoFigures(rms=0.1, as_printed=0.01),
            sigma_ori_mrad=TwoFigures(rms=0.2, as_printed=0.02),
            chi2_per_dof=chi2_per_dof,
        ),
        warnings=(),
        estimator="implicit",
        pose_set_sha256=poses * 64,
        software_version="0.3.0",
        utc=datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC),
    )


def document() -> ParametersDocument:
    """The document of the packaged arm and hinge with their nominal values."""
    arm, base = load_arm("sarcos_dextrous"), make_document(chi2_per_dof=None)
    loop = load_fixture("hinge").fixture.model(arm)
    calibrated = tuple(
        CalibratedEntry.of(entry.name, 0.001 * (k + 1)) for k, entry in enumerate(loop.entries)
    )
    return replace(
        base,
        arm=WhichArm(model=arm.name, serial="SDA-0007"),
        joints=joints_from_table(arm, loop.table, calibrated),
        dh=rows_from_table(loop.table),
        calibrated=calibrated,
        quality=replace(base.quality, scaled_condition_number=33.1),
        warnings=(DocumentWarning(code="RVDT_LINEARITY", text="joint 6: 2 % of full scale"),),
        estimator="paper",
        pose_set_sha256="0123456789abcdef" * 4,
        utc=datetime(2026, 1, 31, 12, 0, 0, 250000, tzinfo=UTC),
    )


GOOD = format_parameters(document()).decode()


def parse(text: str) -> ParametersDocument:
    return parse_parameters(text.encode())
