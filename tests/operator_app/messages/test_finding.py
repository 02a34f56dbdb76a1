"""Every message of a finding, with example figures, compared with the approved text."""

import re
from dataclasses import replace

import pytest

from operator_app.messages.finding import (
    SOURCE_REMEDIES,
    Finding,
    FindingKind,
    NamedSize,
    source_remedy,
)

Kind = FindingKind

EXAMPLE = Finding(
    kind=Kind.REPORTED,
    joint=3,
    joints=(2, 5),
    names=("s_3", "a_5"),
    poses=("7", "8", "9"),
    size=0.0123,
    sigma=0.0021,
    unit="rad",
    figures={
        "turn_rad": 0.002,
        "shift_m": 0.0031,
        "times": 3.4,
        "sigmas": 5.2,
        "limit": 0.0015,
        "lower_rad": 0.5,
        "upper_rad": 1.25,
        "after": 12,
        "count": 3,
        "distinct": 37,
        "of": 40,
        "iterations": 50,
        "solutions": 2,
        "ratio": 2.25,
        "counts": 12.0,
        "full_scale_rad": 1.05,
        "linearity": 0.005,
        "from_line": 1.0,
        "a": 0.355,
        "b": 0.356,
    },
    sizes=(
        NamedSize(name="theta_off_3", size=0.0201, unit="rad", share=0.31),
        NamedSize(name="s_4", size=0.0123, unit="m", share=0.08),
    ),
    reported=("a library reports this", "it says what to do"),
)

RATES = {"theta_off_3": 0.11}
OVERRIDES = {
    Kind.FIXTURE_SLIPPED: {"names": ("tool",)},
    Kind.WRONG_FIXTURE_HINGE: {"names": ("rigid", "sarcal new fixture --kind hinge")},
    Kind.WRONG_FIXTURE_BALL: {"names": ("hinge", "sarcal new fixture --kind ball")},
    Kind.POSE_OUT_OF_RANGE: {"poses": ("7",)},
    Kind.TWIST_OFF: {"names": ("alpha_3",)},
    Kind.READING_MISTAKE: {"names": ("RADIANS",)},
    Kind.REPORTED: {"names": ("PROGRAM",)},
    Kind.SETUP_CHECK: {"names": ("AXIS_FIRST",)},
    Kind.NOT_CROSS_VALIDATED: {"names": ("latest",)},
    Kind.COMPARED_ESTIMATORS: {"names": ("paper", "implicit")},
    Kind.COMPARED_FIXTURES: {"names": ("hinge", "bench_hinge")},
    Kind.COMPARED_FIXTURE_KINDS: {"names": ("hinge", "rigid")},
    Kind.COMPARED_SCALED: {"names": ("A",), "size": 1.5},
    Kind.COMPARED_REFUSED: {"names": ("FORCED", "B")},
    Kind.UNEXPLAINED_PATTERN: {"names": ("STEP", "CHI2_STATED")},
    Kind.ENDPOINTS_SHIFTED: {"names": ("further up",)},
    Kind.ENDPOINTS_UNUSED: {"names": ("hinge",)},
    Kind.CONDITION: {"size": 120.0, "figures": {"limit": 100.0}},
    Kind.CHI2_EXCEEDS: {"size": 2.9},
    Kind.LIMIT_CHI2: {"size": 3.1, "figures": {"limit": 2.0}},
    Kind.READING_JUMP: {"figures": {"lsb": 120.0}},
    Kind.LENGTH_STEP: {"unit": "m"},
    Kind.LENGTH_OFF: {"unit": "m"},
    Kind.COMPARED_CONSTANT: {"unit": "m"},
    Kind.TOO_FEW_POSES: {"size": 12},
    Kind.SIGMAS_WIDE: {"names": ("rvdt_curve_6",)},
    Kind.SIGMAS_USELESS: {"names": ()},
    Kind.FIXED_UNSEEN: {"figures": RATES},
    Kind.FIXED_BY_CHOICE: {"figures": RATES, "size": None},
    Kind.NEVER_REPEATED: {"joints": ()},
}
"""Fields in which the example of a kind differs."""


def example(kind):
    sensor = "RVDT" if kind.name.startswith("RVDT") else "ENCODER"
    return replace(EXAMPLE, **{"kind": kind, "sensor": sensor, **OVERRIDES.get(kind, {})})


def variants(kind):
    """The example, the same with a low probability, and with one pose, where the text depends on it."""
    finding, text = example(kind), kind.text
    examples = {"": finding}
    if "{certain:" in text or "{outlying}" in text:
        examples["less likely"] = replace(finding, probability=0.3)
    if "{several:" in text:
        examples["one pose"] = replace(finding, poses=("7",))
    return examples


@pytest.mark.parametrize(
    "finding",
    [
        pytest.param(finding, id=f"{kind.name} {variant}".strip())
        for kind in FindingKind
        for variant, finding in variants(kind).items()
    ],
)
def test_message_is_approved(finding, approve):
    approve(f"{finding.code}: {finding.text} -> {finding.remedy or '(no remedy)'}")


@pytest.mark.parametrize("source", sorted(SOURCE_REMEDIES))
def test_remedy_of_error_source_is_approved(source, approve):
    approve(source_remedy(f"{source}_6" if source.startswith("rvdt") else source))


@pytest.mark.parametrize(
    "kind", [Kind.READING_STEP, Kind.LENGTH_OFF, Kind.READING_DRIFT, Kind.ENCODER_SCALE]
)
def test_tiny_size_is_not_shown_as_zero(kind):
    text = replace(example(kind), size=2e-8).text
    assert not re.search(r"\b0\.0+ (deg|mm|%)", text), text


def test_record_of_earlier_version_keeps_its_text():
    old = {
        "code": "RVDT_6",
        "probability": 0.7,
        "text": "it strays",
        "remedy": "replace it",
        "refuses": True,
    }
    upgraded = Finding.upgraded_record(old)
    assert upgraded["names"] == ["RVDT_6"]
    assert upgraded["reported"] == ["it strays", "replace it"]
    assert upgraded["blocking"]
    assert Finding.upgraded_record(upgraded) is upgraded
