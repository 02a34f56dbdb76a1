"""Any parameters document comes back to the last bit, and any damage to one is noticed, in words."""

import struct
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from datetime import UTC
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operator_app.config.errors import ConfigError
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
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import format_parameters, parse_parameters, rows_from_table
from solver.chain.kinematics import DhTable
from tests.oracles.parameter_documents import GOOD

FLOAT = st.floats(-360.0, 360.0)
LENGTH = st.floats(-10.0, 10.0)
SIGMA = st.floats(0.0, 1e6)
WORD = st.text(min_size=1, max_size=20, alphabet=st.characters(exclude_categories=("Cs",)))


@st.composite
def documents(draw: st.DrawFn) -> ParametersDocument:
    n = draw(st.integers(1, 8))
    rows = tuple(
        DhRow(
            row=k,
            theta_off_deg=draw(FLOAT),
            s_m=draw(LENGTH),
            a_m=draw(LENGTH),
            alpha_deg=draw(FLOAT),
        )
        for k in range(n + 1)
    )
    names = [f"{kind}_{k}" for kind in ("theta_off", "s", "a", "alpha") for k in range(n + 1)]
    chosen = draw(st.lists(st.sampled_from(names), unique=True))
    calibrated = tuple(CalibratedEntry.of(name, draw(SIGMA)) for name in chosen)
    sigma = {item.entry: item.sigma for item in calibrated}
    figures = st.builds(TwoFigures, rms=SIGMA, as_printed=SIGMA)
    return ParametersDocument(
        arm=WhichArm(model=draw(WORD), serial=draw(WORD)),
        joints=tuple(
            JointParameters(
                joint=k,
                theta_off_deg=rows[k].theta_off_deg,
                sigma_deg=sigma.get(f"theta_off_{k}"),
                home_offset_counts=draw(st.none() | st.integers(-(2**31), 2**31 - 1)),
            )
            for k in range(1, n + 1)
        ),
        dh=rows,
        calibrated=calibrated,
        fixture=WhichFixture(name=draw(WORD), kind=draw(WORD)),
        quality=Quality(
            poses=draw(st.integers(1, 10**6)),
            rank=draw(st.integers(0, len(chosen))),
            scaled_condition_number=draw(st.floats(1.0, 1e300)),
            sigma_pos_mm=draw(figures),
            sigma_ori_mrad=draw(figures),
            chi2_per_dof=draw(st.none() | SIGMA),
        ),
        warnings=tuple(
            DocumentWarning(code="CODE", text=text) for text in draw(st.lists(WORD, max_size=2))
        ),
        estimator=draw(st.sampled_from(["paper", "implicit"])),
        pose_set_sha256=draw(st.text("0123456789abcdef", min_size=64, max_size=64)),
        software_version=draw(WORD),
        utc=draw(st.datetimes(timezones=st.just(UTC))),
    )


def bits(value: Any) -> Iterator[Any]:
    """All leaves of a document, floats as their 64 bits."""
    if is_dataclass(value):
        for field in fields(value):
            yield from bits(getattr(value, field.name))
    elif isinstance(value, tuple):
        for item in value:
            yield from bits(item)
    else:
        yield struct.pack("d", value) if isinstance(value, float) else value


@settings(max_examples=60, deadline=None)
@given(documents())
def test_writing_and_reading_changes_no_bit(original):
    again = parse_parameters(format_parameters(original))
    assert list(bits(again)) == list(bits(original))


@pytest.mark.sample(16)
@pytest.mark.parametrize(
    "missing", [k for k, line in enumerate(GOOD.splitlines()) if not line.startswith("#")]
)
def test_any_line_that_is_cut_out_is_noticed(missing):
    lines = GOOD.splitlines(keepends=True)
    cut = "".join(lines[:missing] + lines[missing + 1 :]).encode()
    with pytest.raises(ConfigError):
        parse_parameters(cut)


def test_any_table_in_radians_survives_the_document_to_the_last_bit_or_the_next():
    """Degrees are not as dense as radians everywhere; where they are, nothing changes."""
    rng = np.random.default_rng(5)
    angles = rng.uniform(-np.pi, np.pi, (2, 500))
    table = DhTable(theta_off_rad=angles[0], s_m=angles[0], a_m=angles[1], alpha_rad=angles[1])
    rows = rows_from_table(table)
    back = np.deg2rad([row.alpha_deg for row in rows])
    np.testing.assert_array_less(np.abs(back - angles[1]), 1.01 * np.spacing(np.abs(angles[1])))
    assert [row.a_m for row in rows] == angles[1].tolist()
