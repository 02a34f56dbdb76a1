"""Findings: faults or facts, each with magnitude, probability, effect on acceptance, text and remedy.

The kind of a finding has the templates of text and remedy. Code reads figures from the fields, never from the texts.
"""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from math import radians
from typing import Any, NamedTuple

from operator_app import units
from operator_app.messages.finding_kind import FindingKind
from operator_app.units import CLOSURE_LENGTH, SHIFTED, TURNED, Figure, joints_named, names

__all__ = ["CERTAIN", "Finding", "FindingKind", "NamedSize", "fixed_briefly", "source_remedy"]

CERTAIN = 0.5
"""A finding is stated as a fact if its probability is at least this, otherwise as a possibility."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedSize:
    """A parameter's value in `unit` ("rad" or "m"). `share`: fraction of the parameter's information from poses."""

    name: str
    size: float
    unit: str
    share: float | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding.

    Attributes
    ----------
    joint, joints
        Number of the joint that the finding is about (from 1; 0: none), or numbers of joints, placements or sockets.
    sensor
        "RVDT" or "ENCODER" if the finding is about a joint's sensor.
    names
        Names of the parameters, entries, fixtures or files that the finding is about.
    size, sigma, unit
        Magnitude of the finding, its standard uncertainty, and the unit of both: "rad", "m", or "" for a plain number.
    figures, sizes
        Other figures for the message, by name, in SI units, and values of several parameters.
    reported
        Text and remedy that a lower layer wrote (fixtures, solver, file readers).
    probability
        Probability of this finding. The alternatives are all other explanations, and that there is no fault.
    doubted
        Whether the finding is stated as a possibility, whatever its probability.
    blocking
        Whether the finding prevents acceptance: parameters may be wrong by more than their sigmas allow.
    """

    kind: FindingKind
    _: KW_ONLY
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
        """Convert the record of a finding to the current format; earlier versions recorded code, text and remedy."""
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
        """The public code, such as ``FROZEN_JOINT_3``."""
        return self.kind.code.format(
            joint=self.joint,
            sensor=self.sensor,
            name=self.names[0] if self.names else "",
            names="_".join(self.names),
        )

    @property
    def certain(self) -> bool:
        """Whether the finding is stated as a fact."""
        return self.probability >= CERTAIN and not self.doubted

    @property
    def text(self) -> str:
        """The text of the finding."""
        return self._filled(self.kind.text)

    @property
    def remedy(self) -> str:
        """The remedy; empty if the text is sufficient."""
        return self._filled(self.kind.remedy)

    @property
    def brief(self) -> str:
        """The sentence or, if it is long, a short form for a small panel."""
        return self._filled(self.kind.brief) or self.sentence

    @property
    def sentence(self) -> str:
        """Text and remedy together."""
        return ": ".join(part for part in (self.text, self.remedy) if part)

    def _filled(self, template: str) -> str:
        return template.format_map(_FindingFields(self))


POSES_NAMED, PARAMETERS_LISTED = 5, 4


def _poses_named(labels: tuple[str, ...]) -> str:
    rest = len(labels) - POSES_NAMED
    more = f" and {rest} more" if rest > 0 else ""
    return f"pose{'s' * (len(labels) > 1)} {', '.join(labels[:POSES_NAMED])}{more}"


def source_remedy(source: str) -> str:
    """Return the remedy that halves a source of error in the uncertainty budget."""
    kind, _, joint = source.rpartition("_")
    written = SOURCE_REMEDIES.get(source) or SOURCE_REMEDIES.get(kind, SOURCE_REMEDIES[""])
    return written.format(joint=joint)


SOURCE_REMEDIES = {
    "": "take more poses that differ more from each other",
    "rvdt_curve": "replace the RVDT of joint {joint} or measure its linearity on a bench",
    "rvdt_gain": "halve the gain error of joint {joint}'s RVDT and state its gain",
    "rvdt_noise": "take four times as many samples of joint {joint} in every pose",
    "lengths": "measure the arm's lengths with half the error and state their tolerance",
    "twists": "measure the arm's twists with half the error and state their tolerance",
    "offsets": "find the joints' zeros by another method and state offset_tolerance_deg",
    "placement": "measure the fixture's placement twice as accurately and state its tolerance",
    "encoder_accuracy": "centre the encoders twice as accurately and state their accuracy_deg",
    "fixture_give": "mount a fixture twice as stiff, or load it less, and state its compliance (key give)",
    "instrument": "measure twice as accurately, or four times as many poses, and state the instrument's sigma",
    "joint_play": "halve the joints' play and state the new value",
    "sag": "state the links' masses, or a smaller sag_deg if the joints really sag less than the arm file states",
    "distances": "measure the distances between the sockets twice as accurately and state their sigma_mm",
    "discrepancy": "measure how the fixture and the arm deflect over the poses, and state that (keys give, sag_deg)",
    "counts": "fit encoders with more counts: averaging at rest does not reduce the error of one count",
}
"""Remedies by source of error, which is named without the joint's number; the remedy of "" is for all other sources."""


class _Amount(NamedTuple):
    """A value, in SI units, that a template formats. The template names a display format of `operator_app.units`.

    ``A|B`` means the format A if `angle` is true, otherwise B. ``d`` means a whole number.
    """

    value: float
    angle: bool

    def __format__(self, spec: str) -> str:
        if spec == "d":
            return str(int(self.value))
        kind = getattr(units, spec.split("|")[0 if self.angle else -1])
        return str(kind.not_zero(self.value).with_unit)


class _Choice(int):
    """A flag for templates: ``{certain:drifts|may drift}`` becomes "drifts" if `certain` is true, else "may drift"."""

    def __format__(self, spec: str) -> str:
        return spec.split("|")[not self]


class _FindingFields(dict[str, object]):
    """Values that a template may use, by name: figures of a finding, and results of the functions in `FIELDS`."""

    def __init__(self, finding: Finding) -> None:
        figures = {"size": finding.size, "sigma": finding.sigma, **finding.figures}
        angle = finding.unit == "rad"
        super().__init__({k: _Amount(v, angle) for k, v in figures.items() if v is not None})
        self._finding = finding

    def __missing__(self, name: str) -> object:
        return FIELDS[name](self._finding)


def fixed_briefly(offsets: tuple[str, ...]) -> str:
    """Return a note that names the fixed offsets on which the tool's accuracy depends."""
    if not offsets:
        return ""
    return f". The error after calibration holds only if the fixed value of {names(offsets)} is right: see the warnings"


def _holds(f: Finding) -> str:
    """Return a note that the tool accuracy holds only if fixed offsets of unknown uncertainty are right.

    `f.figures`: rms tool error by name of the offset, m per rad of error in this offset.
    """
    if not f.figures:
        return ""
    rates = ", ".join(
        f"{Figure(rate * radians(1.0), CLOSURE_LENGTH).with_unit} rms for each degree of error in {name}"
        for name, rate in f.figures.items()
    )
    return (
        f". No file states how well {', '.join(f.figures)} is known: the stated tool accuracy holds only if the "
        f"fixed value is right; otherwise the tool is also off by {rates}"
    )


def _releasing(f: Finding) -> str:
    fixed = ", ".join(f.figures)
    remedy = f"calibrate with a fixture that determines {fixed}, or state offset_tolerance_deg in the arm file"
    return remedy if fixed else ""


def _displacement(f: Finding) -> str:
    turn, shift = f.figures["turn_rad"], f.figures["shift_m"]
    known = [(SHIFTED, shift), (TURNED, turn)]
    # Leave out a value that rounds to zero; if both do, show the shift with more digits.
    parts = [kind(x).with_unit for kind, x in known if kind(x) == kind.not_zero(x) and x > 0.0]
    return " and ".join(parts) or SHIFTED.not_zero(shift).with_unit


def _with_unit(item: NamedSize) -> str:
    kind = units.ANGLE_TOLERANCE if item.unit == "rad" else units.LENGTH_TOLERANCE
    return kind(item.size).with_unit if item.size < float("inf") else "unknown"


def _counts(f: Finding) -> str:
    for name, kind in (("counts", units.LOST_COUNTS), ("lsb", units.LOST_LSB)):
        if name in f.figures:
            return f" ({kind.not_zero(f.figures[name]).with_unit})"
    return ""


def _specified(f: Finding) -> str:
    times = f.figures.get("times")
    return "" if times is None else f", {units.MANY_TIMES(times).shown} times its specification"


def _share(f: Finding) -> str:
    full = f.figures.get("full_scale_rad")
    if full is None or f.size is None or f.sigma is None:
        return ""
    peak, sd = (units.OF_FULL_SCALE(x / full).with_unit for x in (f.size, f.sigma))
    limit = units.LINEARITY(f.figures["linearity"]).with_unit
    return f" ({peak} of full scale, sigma {sd}; specification: at most {limit})"


def _shares(f: Finding) -> str:
    return ", ".join(
        f"{item.name} ({100.0 * (item.share or 0.0):.0f} % from these poses"
        + (f", sigma {_with_unit(item)})" if item.unit else ")")
        for item in f.sizes
    )


def _tolerance(f: Finding) -> str:
    if f.size is None:
        return ""
    known = units.ANGLE_TOLERANCE(f.size).with_unit
    return f"; the stated tolerance of {known} is included in the tool accuracy"


def _range(f: Finding) -> str:
    low, high = (units.SPAN(f.figures[name]) for name in ("lower_rad", "upper_rad"))
    return f"{low.shown} to {high.with_unit}"


def _narrowing(f: Finding) -> str:
    if f.names:
        return f"to halve the largest contribution to them, {source_remedy(f.names[0])}"
    return "take more poses that differ more from each other: every joint through a larger part of its range"


FIELDS: Mapping[str, Callable[[Finding], object]] = {
    "certain": lambda f: _Choice(f.certain),
    "several": lambda f: _Choice(len(f.poses) > 1),
    "one_name": lambda f: _Choice(len(f.names) == 1),
    "joint": lambda f: f.joint,
    "joints": lambda f: joints_named(f.joints),
    "sensor_name": lambda f: "RVDT" if f.sensor == "RVDT" else "encoder",
    "poses": lambda f: _poses_named(f.poses),
    "first": lambda f: f.poses[0],
    "last": lambda f: f.poses[-1],
    "between": lambda f: f"between pose {f.poses[0]} and pose {f.poses[1]}",
    "since": lambda f: f.poses[1],
    "placement": lambda f: f" of placement {f.joints[0]}" if f.joints else "",
    "outlying": lambda f: (
        ("" if f.certain else "possibly ") + ("do" if len(f.poses) > 1 else "does")
    ),
    "name": lambda f: f.names[0],
    "last_name": lambda f: f.names[-1],
    "listed": lambda f: ", ".join(f.names[:PARAMETERS_LISTED]),
    "listed_all": lambda f: ", ".join(f.names),
    "numbers": lambda f: names(f.joints),
    "degrees": lambda f: f"{int(f.size or 0)} degree{'s' * (f.size != 1)}",
    "sizes": lambda f: ", ".join(
        f"{x.name} ({_with_unit(x)})" for x in f.sizes[:PARAMETERS_LISTED]
    ),
    "fixed_at": lambda f: ", ".join(
        f"{x.name} at {units.NOMINAL_OFFSET(x.size).with_unit}" for x in f.sizes
    ),
    "reference": lambda f: "best-fit straight line" if "from_line" in f.figures else "true angle",
    "reported": lambda f: f.reported[0],
    "reported_remedy": lambda f: f.reported[1] if len(f.reported) > 1 else "",
    "displacement": _displacement,
    "in_counts": _counts,
    "specified": _specified,
    "share": _share,
    "shares": _shares,
    "tolerance": _tolerance,
    "range": _range,
    "narrowing": _narrowing,
    "holds": _holds,
    "releasing": _releasing,
}
