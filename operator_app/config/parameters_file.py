"""The parameters file (``sarcal/parameters/1``), written and read strictly. Knows no controller."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from operator_app.config.atomic import write_atomically
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.parameters import (
    CalibratedEntry,
    DhRow,
    DocumentWarning,
    JointParameters,
    ParametersDocument,
    Quality,
    TwoFigures,
)
from operator_app.config.parameters_schema import ParametersFile
from operator_app.config.resources import YAML_LIMIT_BYTES, read_limited
from operator_app.config.schema import read_model
from operator_app.config.yaml_writer import dump_strict
from solver.chain.parameters import DhEntry

COMMENT = "Written by sarcal. A controller checks it against this schema; edit it only on purpose."
RESULT = "the result"
REMEDY = "this calibration cannot be exported: take more and different poses"


def parse_parameters(data: bytes, file: str = "parameters") -> ParametersDocument:
    """Read a parameters document from its bytes.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    found = read_model(ParametersFile, data, kind="parameters", file=file)
    quality = found.quality
    return ParametersDocument(
        arm_model=found.arm.model,
        arm_serial=found.arm.serial,
        joints=tuple(JointParameters(**part.model_dump()) for part in found.joints),
        dh=tuple(DhRow(**part.model_dump()) for part in found.dh),
        calibrated=tuple(
            CalibratedEntry(
                entry=part.entry,
                sigma=part.sigma_deg if part.sigma_deg is not None else part.sigma_m or 0.0,
            )
            for part in found.calibrated
        ),
        fixture=found.fixture.name,
        fixture_kind=found.fixture.kind,
        quality=Quality(
            poses=quality.poses,
            rank=quality.rank,
            scaled_condition_number=quality.scaled_condition_number,
            sigma_pos_mm=TwoFigures(**quality.sigma_pos_mm.model_dump()),
            sigma_ori_mrad=TwoFigures(**quality.sigma_ori_mrad.model_dump()),
            chi2_per_dof=quality.chi2_per_dof,
        ),
        warnings=tuple(DocumentWarning(**part.model_dump()) for part in found.warnings),
        estimator=found.estimator,
        pose_set_sha256=found.pose_set_sha256,
        software_version=found.software_version,
        utc=datetime.fromisoformat(found.utc).astimezone(UTC),
    )


def load_parameters(path: str | Path) -> ParametersDocument:
    """Read a parameters file; raises as `parse_parameters`."""
    where = Path(path).expanduser()
    return parse_parameters(read_limited(where, str(path), limit=YAML_LIMIT_BYTES), str(path))


def format_parameters(document: ParametersDocument) -> bytes:
    """Write a document; `parse_parameters` gives back the same one, bit for bit.

    Raises
    ------
    ConfigError
        The schema would refuse it: an iteration ran away to lengths no arm has, a number is not
        finite, a text is empty. What is written goes to a controller, so it is checked here.
    """
    try:
        data = dump_strict(_plain(document), comment=COMMENT)
    except ValueError as error:
        problem = Problem(file=RESULT, text=str(error), remedy=REMEDY)
        raise ConfigError((problem,)) from error
    try:
        parse_parameters(data, RESULT)
    except ConfigError as error:
        raise ConfigError(replace(p, line=None, remedy=REMEDY) for p in error.problems) from error
    return data


def save_parameters(path: Path, document: ParametersDocument) -> None:
    """Write a parameters file atomically; WriteError when the system refuses, else as above."""
    write_atomically(path, format_parameters(document))


def _plain(document: ParametersDocument) -> dict[str, Any]:
    quality = document.quality

    def figures(value: TwoFigures) -> dict[str, float]:
        return {"rms": value.rms, "as_printed": value.as_printed}

    return {
        "schema": "sarcal/parameters/1",
        "arm": {"model": document.arm_model, "serial": document.arm_serial},
        "utc": document.utc.astimezone(UTC).replace(tzinfo=None).isoformat() + "Z",
        "software_version": document.software_version,
        "estimator": document.estimator,
        "fixture": {"name": document.fixture, "kind": document.fixture_kind},
        "joints": [
            {
                "joint": joint.joint,
                "theta_off_deg": joint.theta_off_deg,
                "sigma_deg": joint.sigma_deg,
                "home_offset_counts": joint.home_offset_counts,
            }
            for joint in document.joints
        ],
        "dh": [
            {
                "row": row.row,
                "theta_off_deg": row.theta_off_deg,
                "s_m": row.s_m,
                "a_m": row.a_m,
                "alpha_deg": row.alpha_deg,
            }
            for row in document.dh
        ],
        "calibrated": [
            {
                "entry": item.entry,
                "sigma_deg" if DhEntry.parse(item.entry).kind.is_angle else "sigma_m": item.sigma,
            }
            for item in document.calibrated
        ],
        "quality": {
            "poses": quality.poses,
            "rank": quality.rank,
            "scaled_condition_number": quality.scaled_condition_number,
            "sigma_pos_mm": figures(quality.sigma_pos_mm),
            "sigma_ori_mrad": figures(quality.sigma_ori_mrad),
            "chi2_per_dof": quality.chi2_per_dof,
        },
        "warnings": [{"code": item.code, "text": item.text} for item in document.warnings],
        "pose_set_sha256": document.pose_set_sha256,
    }
