"""JSON Schemas agree with the readers: valid files match, files with one mistake of form do not."""

from dataclasses import replace
from typing import get_args

import pytest
import yaml

from operator_app.config.any_file import json_schema
from operator_app.config.parameters_file import format_parameters
from operator_app.config.resources import Kind, builtin_names, resolve
from tests.oracles.json_schema import complaints
from tests.oracles.parameter_documents import VALUES, make_document

PACKAGED_FILES = [(kind, name) for kind in get_args(Kind) for name in builtin_names(kind)]
HINGE = resolve("fixture", "hinge").data.decode()
SARCOS = resolve("arm", "sarcos_dextrous").data.decode()
PROCEDURE = resolve("procedure", "hinge").data.decode()
PROFILE = resolve("profile", "sarcos").data.decode()
CALIBRATED = ("theta_off_1", "theta_off_2")
PARAMETERS = format_parameters(
    replace(
        make_document(without=set(VALUES) - set(CALIBRATED)),
        correlations={"theta_off_2": (-0.5,)},
        budget={"theta_off_1": {"lengths": 0.25, "sag": 0.75}},
    )
).decode()


def violations(kind, text):
    schema = json_schema(kind)
    return list(complaints(yaml.safe_load(text), schema, schema))


@pytest.mark.parametrize(
    ("kind", "name", "old", "new"),
    [
        *((*packaged, "", "") for packaged in PACKAGED_FILES),
        ("fixture", "hinge", "give: {position_mm: 0.2, orientation_mrad: 0.2}", "give: 0"),
        ("fixture", "hinge", "give: {position_mm: 0.2, orientation_mrad: 0.2}\n", ""),
        ("fixture", "hinge", "kind: hinge", "kind: hinge\nstiffness: {n_per_m: 2e6, nm_per_rad: 3e4}"),
    ],
)  # fmt: skip
def test_packaged_files_and_alternative_forms_match_schema(kind, name, old, new):
    text = resolve(kind, name).data.decode()
    assert old in text
    assert violations(kind, text.replace(old, new, 1)) == []


BAD = [
    ("fixture", HINGE, "a_0_mm: 200", "a_0_m: 0.2"),
    ("fixture", HINGE, "a_0_mm: 200", "a_0_mm: 20000"),
    ("fixture", HINGE, "kind: hinge", "kind: hinges"),
    ("fixture", HINGE, "orientation_mrad: 0.2", "orientation_mrad: -1"),
    ("fixture", HINGE, "give: {position_mm: 0.2, orientation_mrad: 0.2}", "give: 1"),
    ("fixture", HINGE, "schema: sarcal/fixture/1", "schema: sarcal/fixture/2"),
    ("arm", SARCOS, "tolerance: {length_mm: 0.5", "tolerance: {length_mm: 60"),
    ("arm", SARCOS, "alpha_deg: 90}", "alpha_deg: 400}"),
    ("arm", SARCOS, "s_m: fixture", "s_m: fixtur"),
    ("arm", SARCOS, "counts_per_rev: 400000", "counts_per_rev: 400000.5"),
    ("arm", SARCOS, "counts_per_rev: 400000", "counts: 400000"),
    ("arm", SARCOS, "range_deg: [-35, 115]", "range_deg: [-35]"),
    ("procedure", PROCEDURE, "upload: ", "upload: maybe "),
    ("profile", PROFILE, "supervisor: 16", "supervisor: 0"),
    ("profile", PROFILE, "6064h(32)", "0x6064"),
    ("profile", PROFILE, "180h + node", "180h + nodes"),
    ("profile", PROFILE, "compared: [607Dh", "compared: [607D"),
    ("profile", PROFILE, "pdo: 1", "pdo: 0"),
    ("procedure", PROCEDURE, "poses: ", "poses: -"),
    ("procedure", PROCEDURE, "estimator: ", "estimator: x"),
    ("parameters", PARAMETERS, "estimator: implicit", "estimator: best"),
    ("parameters", PARAMETERS, "utc: ", "utc: at "),
    ("parameters", PARAMETERS, "sigma_deg: 0.001", "sigma_deg: -0.001"),
    ("parameters", PARAMETERS, "[-0.5]", "[-1.5]"),
    ("parameters", PARAMETERS, "[-0.5]", "[none]"),
    ("parameters", PARAMETERS, "sag: 0.75", "sag: 1.75"),
]


@pytest.mark.parametrize(("kind", "good", "old", "new"), BAD)
def test_one_mistake_violates_schema(kind, good, old, new):
    assert old in good
    assert violations(kind, good) == []
    assert violations(kind, good.replace(old, new, 1))
