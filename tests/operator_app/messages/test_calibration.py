"""Every message of a finding with an example of its figures, held to the approved words.

A change of wording is one diff to read: `pytest --approve tests/operator_app/messages` writes it.
"""

from dataclasses import replace

import pytest

from operator_app.messages.calibration import SOURCE_REMEDIES, source_remedy
from operator_app.messages.finding import Finding, FindingKind, NamedSize

K = FindingKind

EXAMPLE = Finding(
    kind=K.REPORTED,
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
        "lower_rad": -1.5,
        "upper_rad": 1.25,
        "after": 12,
        "count": 3,
        "of": 40,
        "iterations": 50,
        "solutions": 2,
        "ratio": 2.25,
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
RVDT_TEXT = (
    "RVDT of joint 3: out of specification; linearity 0.90 % of full scale (specification 0.5 %) over the 83 % of "
    "full scale that the poses cover"
)
RVDT_NOISE = (
    "RVDT of joint 3: out of specification; noise of a single reading 9.0 LSB (specification 2 LSB)"
)
OWN = {
    K.FIXTURE_SLIPPED: {"names": ("tool",), "poses": ("7", "8")},
    K.WRONG_FIXTURE_HINGE: {"names": ("rigid", "sarcal new fixture --kind hinge")},
    K.WRONG_FIXTURE_BALL: {"names": ("hinge", "sarcal new fixture --kind ball")},
    K.READING_STEP: {"figures": {"counts": 12.0}},
    K.OUT_OF_RANGE: {"size": 1.6},
    K.OUT_OF_RANGE_NOTICE: {"size": 1.6},
    K.WHOLE_TURN_OFF: {"size": 6.3},
    K.WHOLE_TURN_OFF_NOTICE: {"size": 6.3},
    K.SATURATED: {"size": 1.25},
    K.SATURATED_NOTICE: {"size": 1.25},
    K.POSE_OUT_OF_RANGE: {"poses": ("7",)},
    K.TWIST_OFF: {"names": ("alpha_3",)},
    K.READING_MISTAKE: {
        "names": ("RADIANS",),
        "reported": (
            "all readings become plausible if taken as radians",
            "multiply the angles of the poses file by 57.29578",
        ),
    },
    K.REPORTED: {
        "names": ("PROGRAM",),
        "reported": ("an older version of this program wrote this session", "solve it again"),
    },
    K.SETUP_CHECK: {
        "names": ("AXIS_FIRST",),
        "reported": (
            "the hinge axis makes an angle of 4.0 deg with joint 1's axis",
            "tilt the hinge",
        ),
    },
    K.PARALLEL_AXES: {
        "reported": (
            "the hinge axis makes an angle of 0.2 deg with joint 1's axis",
            "tilt the hinge",
        )
    },
    K.NOT_IDENTIFIABLE: {"reported": ("these poses do not separate theta_off_1 and alpha_0",)},
    K.RVDT_VERDICT: {"names": ("within specification",), "reported": (RVDT_TEXT,)},
    K.RVDT_HARMFUL: {"names": ("out of specification",), "reported": (RVDT_TEXT,)},
    K.RVDT_OUT_LINEARITY: {"reported": (RVDT_TEXT,)},
    K.RVDT_OUT_SPREAD: {"reported": (RVDT_NOISE,)},
    K.RVDT_OUT_NOISE: {"reported": (RVDT_NOISE,)},
    K.SAME_PLACEMENT: {"names": ("alpha_0",), "figures": {"sigmas": 0.8}},
    K.JOURNAL_TORN: {"reported": ("line 42 of journal.jsonl is incomplete and was left out",)},
    K.SOLVED_AGAIN: {"reported": ("poses were excluded after the last calibration",)},
    K.NOT_REPEATED: {"poses": ("1", "10", "14"), "reported": ("the capture ended before that",)},
    K.NOT_CROSS_VALIDATED: {"names": ("latest",)},
    K.COMPARED_ESTIMATORS: {"names": ("paper", "implicit")},
    K.COMPARED_FIXTURES: {"names": ("hinge", "bench_hinge")},
    K.COMPARED_FIXTURE_KINDS: {"names": ("hinge", "rigid")},
    K.READING_JUMP: {"size": 0.4, "figures": {"lsb": 120.0}},
    K.RVDT_NONLINEAR: {
        "figures": {"full_scale_rad": 1.05, "linearity": 0.005, "from_line": 1.0},
        "sensor": "RVDT",
    },
    K.LENGTH_STEP: {"unit": "m"},
    K.LENGTH_OFF: {"unit": "m"},
    K.UNEXPLAINED_PATTERN: {"names": ("STEP", "CHI2_STATED")},
    K.UNEXPLAINED_SCATTER: {"figures": {"times": 2.6}},
    K.ENDPOINTS_UNUSED: {"names": ("hinge",)},
    K.TOO_FEW_POSES: {"size": 12},
    K.SIGMAS_WIDE: {"names": ("rvdt_curve_6",)},
    K.SIGMAS_USELESS: {"names": ()},
    K.CONDITION: {"size": 120.0, "figures": {"limit": 100.0}},
    K.CHI2_EXCEEDS: {"size": 2.9},
    K.FIXED_UNSEEN: {"figures": RATES},
    K.FIXED_BY_CHOICE: {"figures": RATES, "size": None},
    K.LIMIT_CHI2: {"size": 3.1, "figures": {"limit": 2.0}},
    K.NEVER_REPEATED: {
        "joints": (),
        "poses": ("1", "10", "14"),
        "reported": ("the capture ended before that",),
    },
    K.COMPARED_CONSTANT: {"unit": "m"},
    K.COMPARED_SCALED: {"names": ("A",), "size": 1.5},
    K.COMPARED_REFUSED: {
        "names": ("FORCED", "B"),
        "reported": ("not accepted (chi2/dof 3.10 is above 2.00); exported because: bench test",),
    },
}
"""What an example needs of its own."""


def example(kind):
    sensor = "RVDT" if kind.name.startswith("RVDT") else "ENCODER"
    return replace(EXAMPLE, **{"kind": kind, "sensor": sensor, **OWN.get(kind, {})})


def variants(kind):
    """The example as it is, less likely, and of one pose, as far as the message tells them apart."""
    found, text = example(kind), kind.text
    other = {"": found}
    if "{certain:" in text or "{outlying}" in text:
        other["less likely"] = replace(found, probability=0.3)
    if "{several:" in text:
        other["one pose"] = replace(found, poses=("7",))
    return other


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(found, id=f"{kind.name} {variant}".strip())
        for kind in FindingKind
        for variant, found in variants(kind).items()
    ],
)
def test_every_message_is_as_approved(found, approve):
    approve(f"{found.code}: {found.text} -> {found.remedy or '(no remedy)'}")


@pytest.mark.parametrize("source", sorted(SOURCE_REMEDIES))
def test_what_halves_a_source_is_as_approved(source, approve):
    approve(source_remedy(f"{source}_6" if source.startswith("rvdt") else source))


@pytest.mark.parametrize(
    ("found", "code"),
    [
        (Finding(kind=K.READING_FROZEN, joint=3), "FROZEN_JOINT_3"),
        (Finding(kind=K.READING_NOISE, joint=6, sensor="RVDT"), "RVDT_6"),
        (Finding(kind=K.ENTRIES_EXCHANGED, names=("s_3", "s_5")), "EXCHANGED_s_3_s_5"),
        (Finding(kind=K.OUT_OF_RANGE, joint=2), "RANGE_2"),
        (Finding(kind=K.OUT_OF_RANGE_NOTICE, joint=2), "RANGE"),
        (Finding(kind=K.LENGTH_OFF, names=("s_3",)), "LENGTH_s_3"),
    ],
)
def test_the_public_code_follows_from_the_fields(found, code):
    assert found.code == code


def test_a_step_too_small_for_its_format_is_not_denied():
    step = Finding(kind=K.READING_STEP, joint=1, poses=("1", "2"), size=2e-8, unit="rad")
    assert "0.000001 deg" in step.text


def test_a_record_of_an_earlier_version_keeps_what_it_said():
    old = {
        "code": "RVDT_6",
        "probability": 0.7,
        "text": "it strays",
        "remedy": "replace it",
        "refuses": True,
    }
    data = Finding.upgraded_record(old)
    assert data["names"] == ["RVDT_6"]
    assert data["reported"] == ["it strays", "replace it"]
    assert data["blocking"]
    assert Finding.upgraded_record(data) is data
