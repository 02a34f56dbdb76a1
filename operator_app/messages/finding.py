"""A finding: a fault or a fact with its place, size and probability, and whether it blocks acceptance.

Its text and remedy are written in `operator_app.messages.calibration`; no code reads figures back from them.
"""

# Kinds share public codes.
# ruff: noqa: PIE796
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Self

CERTAIN = 0.5
"""Least probability of a finding stated as a fact; less probable ones are stated as possibilities."""


class FindingKind(Enum):
    """Kind of a finding; `template` is the pattern of its code in JSON, journals and the API, which is a contract.

    Several kinds with different texts may share a code.
    """

    template: str

    def __new__(cls, template: str) -> Self:
        """Keep members with the same code distinct, by a running number as the value."""
        member = object.__new__(cls)
        member._value_ = len(cls.__members__)
        member.template = template
        return member

    # Faults of fixture, arm and sensors.
    FIXTURE_SLIPPED = "SLIP_FIXTURE"
    FIXTURE_DEFLECTS_MORE = "FIXTURE_GIVES"
    FIXTURE_DEFLECTS_OTHERWISE = "FIXTURE_GIVES"
    FIXTURE_TURNS_RANDOMLY = "FIXTURE_GIVES"
    FIXTURE_SHIFTS_RANDOMLY = "FIXTURE_GIVES"
    WRONG_FIXTURE_HINGE = "WRONG_FIXTURE"
    WRONG_FIXTURE_BALL = "WRONG_FIXTURE"
    READING_STEP = "STEP_JOINT_{joint}"
    READING_JUMP = "STEP_JOINT_{joint}"
    READING_DRIFT = "DRIFT_JOINT_{joint}"
    READING_NOISE = "{sensor}_{joint}"
    READING_UNRELATED = "{sensor}_{joint}"
    READING_FROZEN = "FROZEN_JOINT_{joint}"
    MOTION_DURING_SAMPLING = "UNSTEADY_{joint}"
    ALL_READINGS_NOISE = "SCATTER"
    ENCODER_SCALE = "SCALE_{joint}"
    ENCODER_CYCLIC_ERROR = "{sensor}_{joint}"
    ENCODERS_EXCEED = "ENCODERS"
    RVDT_NONLINEAR = "{sensor}_{joint}"
    RVDT_NOISE_EXCEEDS = "{sensor}_{joint}"
    RVDT_LINEARITY_EXCEEDS = "{sensor}_{joint}"
    RVDT_GAIN_EXCEEDS = "{sensor}_{joint}"
    RVDT_VERDICT = "{sensor}_{joint}"
    RVDT_HARMFUL = "{sensor}_{joint}"
    RVDT_OUT_LINEARITY = "{sensor}_{joint}"
    RVDT_OUT_SPREAD = "{sensor}_{joint}"
    RVDT_OUT_NOISE = "{sensor}_{joint}"
    JOINT_SAG = "SAG_JOINT_{joint}"
    PLAY_EXCEEDS = "PLAY"
    SAG_EXCEEDS = "SAG"
    LENGTH_STEP = "STEP_LENGTH_{name}"
    LENGTH_OFF = "LENGTH_{name}"
    TWIST_OFF = "TWIST_{name}"
    LENGTHS_EXCEED = "LENGTHS"
    TWISTS_EXCEED = "TWISTS"
    REPEAT_FIXTURE_MOVED = "RETURN_FIXTURE"
    REPEAT_READING_STEP = "RETURN_JOINT_{joint}"
    UNEXPLAINED_SCATTER = "UNNAMED"
    UNEXPLAINED_PATTERN = "UNNAMED"
    POSES_DO_NOT_FIT = "UNNAMED"

    # Mistakes in files.
    READING_MISTAKE = "{name}"
    OFFSETS_IN_RADIANS = "RADIANS_OFFSETS"
    ENTRIES_EXCHANGED = "EXCHANGED_{names}"
    OUT_OF_RANGE = "RANGE_{joint}"
    WHOLE_TURN_OFF = "RANGE_{joint}"
    SATURATED = "SATURATED_{joint}"
    OUT_OF_RANGE_NOTICE = "RANGE"
    WHOLE_TURN_OFF_NOTICE = "RANGE"
    SATURATED_NOTICE = "RANGE"
    POSES_IN_RADIANS = "RANGE_RADIANS"
    POSE_OUT_OF_RANGE = "RANGE_POSE"

    # Poses.
    POSES_FLIPPED = "FLIPPED_BRANCH"
    OUTLIERS = "OUTLIERS"
    OUTLIERS_COUNT = "OUTLIER"
    TOO_FEW_POSES = "TOO_FEW_POSES"
    SIGMAS_USELESS = "LITTLE_MOTION"
    SIGMAS_WIDE = "LITTLE_MOTION"
    CONDITION = "CONDITION"
    KNOWN_BY_FILES = "AS_STATED"
    SAME_PLACEMENT = "SAME_PLACEMENT"
    DISTANCE_ABOVE = "DISTANCE"
    DISTANCE_BELOW = "DISTANCE"
    ENDPOINTS_UNUSED = "ENDPOINTS_UNUSED"
    NOT_IDENTIFIABLE = "UNSEEN"
    NOT_REPEATED = "NO_RETURN"
    NEVER_REPEATED = "NO_RETURN"

    # The solution.
    NOT_CONVERGED = "NOT_CONVERGED"
    OTHER_SOLUTION = "OTHER_SOLUTION"
    FAR_FROM_NOMINAL = "FAR_FROM_NOMINAL"
    SOCKET_ELSEWHERE = "SOCKET_ELSEWHERE"
    SECOND_SOLUTION = "SECOND_SOLUTION"
    PAPER_OFF = "PAPER_OFF"
    PARALLEL_AXES = "PARALLEL_AXES"
    DIVERGED = "ASTRAY"
    CHI2_EXCEEDS = "CHI2"
    FIXED_UNSEEN = "HELD"
    FIXED_BY_CHOICE = "HELD"
    LENGTHS_EXACT = "LENGTHS_EXACT"
    SETUP_CHECK = "{name}"
    LIMIT_SIGMA_POS = "SIGMA_POS_LIMIT"
    LIMIT_SIGMA_ORI = "SIGMA_ORI_LIMIT"
    LIMIT_CHI2 = "CHI2_LIMIT"

    # Sessions, reports and files.
    REPORTED = "{name}"
    JOURNAL_TORN = "TORN"
    SOLVED_AGAIN = "SOLVED_AGAIN"
    NOT_CROSS_VALIDATED = "UNCHECKED"
    CIRCULAR_TABLE = "CIRCULAR_TABLE"

    # Comparisons of two calibrations.
    COMPARED_BACKWARDS = "ORDER"
    COMPARED_SAME_POSES = "SAME_POSES"
    COMPARED_FIXTURE_KINDS = "FIXTURE_KIND"
    COMPARED_FIXTURES = "FIXTURE"
    COMPARED_ESTIMATORS = "ESTIMATOR"
    COMPARED_ENTRIES = "ENTRIES"
    COMPARED_CONSTANT = "TABLE"
    COMPARED_REFUSED = "{name}"
    COMPARED_SCALED = "CHI2"


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedSize:
    """A parameter with a value: `unit` is "rad" or "m"; `share` (0..1) is the poses' share of its information."""

    name: str
    size: float
    unit: str
    share: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One finding.

    Attributes
    ----------
    joint, joints
        The joint (1-based, 0 for none), and all joints if there are several; for placements and sockets, their numbers.
    sensor
        "RVDT" or "ENCODER" if the finding is about a joint's sensor.
    names
        Parameters, entries, fixtures or files concerned.
    size, sigma, unit
        Its size and standard uncertainty, and their unit: "rad", "m", or "" for a plain number.
    figures
        Its other figures, in SI units.
    sizes
        Sizes of several parameters.
    reported
        Text and remedy that a lower layer wrote (fixtures, solver, file readers).
    probability
        Probability relative to all other explanations, including no fault.
    doubted
        Whether it is always stated as a mere possibility.
    blocking
        Whether it prevents acceptance: parameters may be wrong by more than their sigmas allow.
    """

    kind: FindingKind
    joint: int = 0
    joints: tuple[int, ...] = ()
    sensor: str = ""
    names: tuple[str, ...] = ()
    poses: tuple[str, ...] = ()
    size: float | None = None
    sigma: float | None = None
    unit: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    sizes: tuple[NamedSize, ...] = ()
    reported: tuple[str, ...] = ()
    probability: float = 1.0
    doubted: bool = False
    blocking: bool = False

    @staticmethod
    def upgraded_record(data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Convert a record to the current format; those of earlier versions have code, text and remedy."""
        if "kind" in data:
            return data
        return {
            "kind": FindingKind.REPORTED.name,
            "names": [data["code"]],
            "reported": [data["text"], data.get("remedy", "")],
            "probability": data.get("probability", 1.0),
            "blocking": data.get("refuses", False),
        }

    @property
    def code(self) -> str:
        """The public code, ``FROZEN_JOINT_3``."""
        return self.kind.template.format(
            joint=self.joint,
            sensor=self.sensor,
            name=self.names[0] if self.names else "",
            names="_".join(self.names),
        )

    @property
    def certain(self) -> bool:
        """Whether it is stated as a fact."""
        return self.probability >= CERTAIN and not self.doubted

    @property
    def text(self) -> str:
        """The text of the finding."""
        from operator_app.messages.calibration import words

        return words(self)[0]

    @property
    def remedy(self) -> str:
        """The remedy; empty if the text is sufficient."""
        from operator_app.messages.calibration import words

        return words(self)[1]

    @property
    def brief(self) -> str:
        """The sentence or, if it is long, a short form for a small panel."""
        from operator_app.messages.calibration import brief

        return brief(self)

    @property
    def sentence(self) -> str:
        """Text and remedy together."""
        return ": ".join(part for part in (self.text, self.remedy) if part)
