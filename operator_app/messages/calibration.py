"""Text and remedy of every finding; no other module contains such texts.

A message is a template. ``{size:STEP}`` is a figure in one of the formats of `operator_app.units`,
``{limit:ANGLE|LENGTH}`` in the first one if the finding's unit is rad, else in the second; ``{certain:drifts|may
drift}`` is the first choice if the finding is certain, ``{several:do|does}`` if it is about several poses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import radians

from operator_app import units
from operator_app.messages.finding import Finding, FindingKind, NamedSize
from operator_app.units import CLOSURE_LENGTH, SHIFTED, TURNED, Figure, joints_named, names

NAMED = 5
"""How many poses a message lists by label."""

LISTED = 4
"""How many parameters a message lists."""

K = FindingKind


def words(found: Finding) -> tuple[str, str]:
    """Return the text and the remedy of a finding."""
    fields = _Fields(found)
    text, remedy = MESSAGES[found.kind]
    return text.format_map(fields), remedy.format_map(fields)


def brief(found: Finding) -> str:
    """Return the text of a finding for a small panel; for an RVDT, the verdict without figures."""
    template = BRIEF.get(found.kind)
    return found.sentence if template is None else template.format_map(_Fields(found))


def poses_named(labels: tuple[str, ...]) -> str:
    """Return ``pose 4`` or ``poses 4, 7 and 3 more``."""
    rest = len(labels) - NAMED
    more = f" and {rest} more" if rest > 0 else ""
    return f"pose{'s' * (len(labels) > 1)} {', '.join(labels[:NAMED])}{more}"


def source_remedy(source: str) -> str:
    """Return a remedy with which a source in the uncertainty budget can be halved."""
    kind, _, joint = source.rpartition("_")
    written = SOURCE_REMEDIES.get(source) or SOURCE_REMEDIES.get(kind, SOURCE_REMEDIES[""])
    return written.format(joint=joint)


SOURCE_REMEDIES = {
    "": "take more poses that differ more from each other",
    "rvdt_curve": "replace the RVDT of joint {joint} or measure its linearity on a bench",
    "rvdt_gain": "set the scale factor of joint {joint}'s RVDT twice as accurately and state the tolerance of its gain",
    "rvdt_noise": "take four times as many samples of joint {joint} in every pose",
    "lengths": "measure the arm's lengths twice as accurately and state their tolerance",
    "twists": "measure the arm's twists twice as accurately and state their tolerance",
    "offsets": "find the joints' zeros by another method and state offset_tolerance_deg",
    "placement": "measure the fixture's placement twice as accurately and state its tolerance",
    "encoder_accuracy": "centre the encoders twice as accurately and state their accuracy_deg",
    "fixture_give": "mount a fixture twice as stiff, or load it less, and state its compliance (give)",
    "instrument": "measure twice as accurately, or four times as many poses, and state the instrument's sigma",
    "joint_play": "halve the joints' play and state it",
    "sag": "state the links' masses, or a smaller sag if the joints sag less",
    "distances": "measure the distances of the sockets twice as accurately and state their sigma_mm",
    "discrepancy": "find the deflection that depends on the pose and that no file states",
    "counts": "fit encoders with more counts: averaging does not help an encoder at rest",
}
"""Remedies by source of the budget, without the joint's number."""

_FIX_BOLTS = "tighten its bolts and check for play; otherwise state its compliance (give) in the fixture file"
_UNSENSED = "calibrate with --unsensed {joint}"
_NEARER = "take more poses that differ more from each other, or state nominal values closer to the true ones"
_REPEAT_JOINT = (
    "check the coupling and cable of joint {joint}'s sensor (count loss, a slipped coupling), home the joint and "
    "take all poses again"
)
_RANGE = (
    "joint {joint} reads {size:READING} in {poses}, outside its range {range}",
    "check these readings for damage, or correct range_deg in the arm file",
)
_WHOLE_TURN = (
    (
        "joint {joint} reads {size:READING} in {poses}, whole turns away from its range {range}: its encoder counts "
        "from another turn"
    ),
    "home the joint or correct range_deg in the arm file",
)
_SATURATED = (
    (
        "joint {joint} reads {size:READING} in {poses}, the end of its sensor's full scale ({range}): the sensor reads "
        "the same for every angle beyond it"
    ),
    "take these poses closer to the middle of the sensor's range, or exclude them",
)
_HOLDS_ONLY = (
    ". No file states how well {fixed} is known: the stated tool accuracy holds only if the fixed value is right; "
    "otherwise the tool is also off by {rates}. Calibrate it in a fixture that determines it, or state "
    "offset_tolerance_deg in the arm's file"
)

_TOGETHER = (
    "check that arm file, fixture file and poses belong together, and what was done between the poses; try "
    "--global-start"
)
_DISTANCE = "measure it again and correct it in the file; it scales the arm's lengths"
_DISTURBED = "take more poses, look for a pose that was disturbed, or leave out the joint that the warnings name"
_NOT_REPEATED = (
    "pose {first}{placement} was not measured again after pose {last} ({reported}): only the poses themselves show "
    "whether a joint or the fixture slipped since pose {since}, and a slip in the last poses is hard to detect"
)

MESSAGES: Mapping[FindingKind, tuple[str, str]] = {
    # Faults of fixture, arm and sensors.
    K.FIXTURE_SLIPPED: (
        "the fixture {certain:slipped|may have slipped} on the {name} by about {displacement} {between}",
        "tighten it on the {name} and take all poses again, or use only those before or after pose {last}",
    ),
    K.FIXTURE_DEFLECTS_MORE: (
        "the fixture {certain:deflects|may deflect} by about {displacement}, more than its file states",
        _FIX_BOLTS,
    ),
    K.FIXTURE_DEFLECTS_OTHERWISE: (
        "the fixture {certain:deflects|may deflect} by about {displacement}, which depends on neither load nor pose",
        _FIX_BOLTS,
    ),
    K.FIXTURE_TURNS_RANDOMLY: (
        (
            "the fixture turns by about {size:GIVES_ANGLE} at random in every pose, {times:TIMES} times what its file "
            "states"
        ),
        _FIX_BOLTS,
    ),
    K.FIXTURE_SHIFTS_RANDOMLY: (
        (
            "the fixture shifts by about {size:GIVES_LENGTH} at random in every pose, {times:TIMES} times what its "
            "file states"
        ),
        _FIX_BOLTS,
    ),
    K.WRONG_FIXTURE_HINGE: (
        "the loops close like those of a hinge, not of a {name} fixture",
        "calibrate with the fixture file of that hinge; this command writes one from these poses: {last_name}",
    ),
    K.WRONG_FIXTURE_BALL: (
        "the loops close like those of a ball that turns freely, not of a {name} fixture",
        (
            "find why the fixture can tilt; or, if it is a ball, calibrate with a fixture file of that ball and "
            "--drop-unidentifiable (a ball does not separate the first joint's offset from the socket's place); "
            "this command writes one from these poses: {last_name}"
        ),
    ),
    K.READING_STEP: (
        "the reading of joint {joint} {certain:shifted|may have shifted} by {size:STEP}{in_counts} {between}",
        _REPEAT_JOINT,
    ),
    K.READING_JUMP: (
        (
            "the reading of joint {joint} {certain:jumped|may have jumped} by {size:TARGET}{in_counts} {between}: its "
            "node restarted or its sensor came off"
        ),
        "home joint {joint} and take all poses again",
    ),
    K.READING_DRIFT: (
        "the reading of joint {joint} {certain:drifts|may drift} by about {size:STEP} from the first pose to the last",
        "let arm and electronics warm up, check the coupling of joint {joint}'s sensor, then take all poses again",
    ),
    K.READING_NOISE: (
        "the reading of joint {joint} {certain:scatters|may scatter} by {size:SCATTER}{specified}",
        "check the sensor and cable of joint {joint}, or " + _UNSENSED,
    ),
    K.READING_UNRELATED: (
        "the reading of joint {joint} {certain:does|may} not follow the joint's angle as the loop measures it",
        "check the sensor, cable and channel of joint {joint}; until then " + _UNSENSED,
    ),
    K.READING_FROZEN: (
        (
            "the sensor of joint {joint} {certain:reads|may read} the same from pose {first} to pose {last}, while the "
            "loop shows that the joint moved"
        ),
        "check the sensor and cable of joint {joint}, then take these poses again; or " + _UNSENSED,
    ),
    K.MOTION_DURING_SAMPLING: (
        (
            "the readings of joint {joint} spread by up to {size:SCATTER} within {poses}, more than the noise of its "
            "{sensor_name}: it moved or vibrated while it was read"
        ),
        "wait until the arm has settled, check for vibration, and take these poses again",
    ),
    K.ALL_READINGS_NOISE: (
        (
            "the readings of all joints {certain:scatter|may scatter} by about {size:SCATTER} from pose to pose, more "
            "than their sensors do: vibration, play, or an arm that had not settled"
        ),
        (
            "wait longer before each pose and average more samples, check for vibration and loose couplings, then take "
            "all poses again"
        ),
    ),
    K.ENCODER_SCALE: (
        "the scale of joint {joint}'s encoder {certain:is|may be} off by about {size:OFF_SCALE}",
        "check counts_per_rev and the gear ratio of joint {joint} in arm file and drive, then take all poses again",
    ),
    K.ENCODER_CYCLIC_ERROR: (
        (
            "the encoder of joint {joint} {certain:errs|may err} by {size:SCATTER} rms once or twice a turn, more than "
            "its file states"
        ),
        "check the centring of joint {joint}'s encoder, or state its accuracy_deg",
    ),
    K.ENCODERS_EXCEED: (
        "the encoders err by about {times:TIMES} times what the arm file states",
        "check their centring, or state their accuracy_deg",
    ),
    K.RVDT_NONLINEAR: (
        (
            "the RVDT of joint {joint} {certain:deviates|may deviate} from its {reference} by up to "
            "{size:DEVIATION}{share}"
        ),
        "replace or linearise the RVDT of joint {joint}, or " + _UNSENSED,
    ),
    K.RVDT_NOISE_EXCEEDS: (
        "the readings of joint {joint}'s RVDT scatter about {times:TIMES} times what its specification states",
        "check its plug, screen and excitation, or " + _UNSENSED,
    ),
    K.RVDT_LINEARITY_EXCEEDS: (
        "the linearity deviation of joint {joint}'s RVDT is about {times:TIMES} times what its specification states",
        "replace or linearise it, or " + _UNSENSED,
    ),
    K.RVDT_GAIN_EXCEEDS: (
        "the gain of joint {joint}'s RVDT is off by about {times:TIMES} times what its specification states",
        "have its scale factor set or state the tolerance of its gain, or " + _UNSENSED,
    ),
    K.RVDT_VERDICT: ("{reported}", ""),
    K.RVDT_HARMFUL: ("{reported}", ""),
    K.RVDT_OUT_LINEARITY: ("{reported}", "replace or linearise it, or " + _UNSENSED),
    K.RVDT_OUT_SPREAD: (
        "{reported}",
        "check whether the spread of its readings is as recorded (sd{joint}_deg), or " + _UNSENSED,
    ),
    K.RVDT_OUT_NOISE: ("{reported}", "find what disturbs it, or " + _UNSENSED),
    K.JOINT_SAG: (
        "joint {joint} {certain:twists|may twist} by {size:SCATTER} rms with the pose, more than its file states",
        "check joint {joint} for play or a weak link, or state its sag_deg",
    ),
    K.PLAY_EXCEEDS: (
        "the joints' play is about {times:TIMES} times what the arm file states",
        "check bearings and couplings for wear, or state the joints' play",
    ),
    K.SAG_EXCEEDS: (
        "the joints' sag under load is about {times:TIMES} times what the arm file states",
        "check bearings and couplings for wear, or state the joints' sag under load",
    ),
    K.LENGTH_STEP: (
        "{name} {certain:changed|may have changed} by {size:GREW} {between}",
        "check for a loose joint or link at {name}, then take all poses again",
    ),
    K.LENGTH_OFF: (
        (
            "{name} {certain:differs|may differ} from the arm file by about {size:OFF_LENGTH} (tolerance "
            "{limit:LENGTH_TOLERANCE})"
        ),
        "measure {name} and correct the arm file, or state a larger tolerance for its row",
    ),
    K.TWIST_OFF: (
        (
            "{name} {certain:differs|may differ} from the arm file by about {size:TARGET} (tolerance "
            "{limit:ANGLE_TOLERANCE})"
        ),
        "measure {name} and correct the arm file, or state a larger tolerance for its row",
    ),
    K.LENGTHS_EXCEED: (
        "the arm's lengths differ from its file by about {times:TIMES} times the stated tolerance",
        "measure the arm and correct the file, or state a larger tolerance for its lengths",
    ),
    K.TWISTS_EXCEED: (
        "the arm's twists differ from its file by about {times:TIMES} times the stated tolerance",
        "measure the arm and correct the file, or state a larger tolerance for its twists",
    ),
    K.REPEAT_FIXTURE_MOVED: (
        (
            "the fixture moved by about {displacement} between pose {first} and its second reading after {after:d} "
            "poses, more than its file states"
        ),
        (
            "tighten its bolts and check for play, then take all poses again; otherwise state its compliance (give) in "
            "the fixture file"
        ),
    ),
    K.REPEAT_READING_STEP: (
        (
            "the reading of joint {joint} shifted by {size:POSITION} (sigma {sigma:SLIP_SIGMA}) between pose {first} "
            "and its second reading after {after:d} poses"
        ),
        _REPEAT_JOINT,
    ),
    K.UNEXPLAINED_SCATTER: (
        "the readings scatter {times:TIMES} times as much as the files state and no single fault explains it",
        _TOGETHER,
    ),
    K.UNEXPLAINED_PATTERN: (
        (
            "the readings scatter no more than the files state, but their pattern is not due to chance ({tests}), and "
            "no single fault explains it"
        ),
        _TOGETHER,
    ),
    K.POSES_DO_NOT_FIT: (
        (
            "these poses do not fit this arm and fixture: the readings scatter {times:TIMES} times as much as the "
            "files state, and no fault of a joint, a length or a pose explains it"
        ),
        (
            "check whether they belong to another arm or fixture, or to this arm before a change, and what was done "
            "between the poses; try --global-start"
        ),
    ),
    # Mistakes in files.
    K.READING_MISTAKE: ("{reported}, and the loops close", "{reported_remedy}"),
    K.OFFSETS_IN_RADIANS: (
        "the loops close if theta_off_deg of the arm file is taken as radians",
        "the unit of an arm file is deg: multiply its theta_off_deg by 57.29578",
    ),
    K.ENTRIES_EXCHANGED: (
        "the loops close if {name} and {last_name} of the arm file are exchanged",
        "measure {name} and {last_name} and correct the arm file",
    ),
    K.OUT_OF_RANGE: _RANGE,
    K.OUT_OF_RANGE_NOTICE: _RANGE,
    K.WHOLE_TURN_OFF: _WHOLE_TURN,
    K.WHOLE_TURN_OFF_NOTICE: _WHOLE_TURN,
    K.SATURATED: _SATURATED,
    K.SATURATED_NOTICE: _SATURATED,
    K.POSES_IN_RADIANS: (
        (
            "{poses} {several:are|is} outside the arm's ranges if read as degrees but inside if read as radians, and "
            "{several:were|was} left out"
        ),
        "multiply the angles of {several:these rows|this row} by 57.29578",
    ),
    K.POSE_OUT_OF_RANGE: (
        "{poses} was left out: {joints} are outside their ranges in it",
        "correct that row, take the pose again or remove it",
    ),
    # Poses.
    K.POSES_FLIPPED: (
        (
            "{poses} ({count:d} of {of:d}) {several:close|closes} only with the tool upside down on the hinge and "
            "{several:were|was} left out"
        ),
        "take {several:them|it} again with the tool the right way up, or remove {several:them|it}",
    ),
    K.OUTLIERS: (
        "{poses} {outlying} not fit the others",
        "find what disturbed {several:them|it}, exclude {several:them|it} and calibrate again",
    ),
    K.OUTLIERS_COUNT: (
        "{poses} {several:do|does} not fit the others and {several:are|is} still used",
        "find what disturbed {several:them|it}, then decide whether to exclude {several:them|it}",
    ),
    K.TOO_FEW_POSES: (
        "{degrees} of freedom {one:is|are} too few to tell whether anything is wrong",
        "take at least 20 poses",
    ),
    K.SIGMAS_USELESS: (
        "these poses determine {sizes} no better than was known before (standard uncertainty in brackets)",
        "{narrowing}",
    ),
    K.SIGMAS_WIDE: (
        "these poses determine {sizes} only roughly (standard uncertainty in brackets)",
        "{narrowing}",
    ),
    K.CONDITION: (
        "scaled condition number {size:CONDITION} is above {limit:CONDITION} (weakest direction: {listed})",
        "poses that differ more from each other would give smaller sigmas",
    ),
    K.KNOWN_BY_FILES: ("known from the files more than from the poses: {shares}", ""),
    K.SAME_PLACEMENT: (
        (
            "placements {numbers} of the fixture are the same within their sigmas (largest difference: {name}, "
            "{size:ANGLE|LENGTH}, {sigmas:SIGMAS} sigma): the fixture was not remounted between them, or is back "
            "exactly where it was; together they determine no more than one placement"
        ),
        "mount it elsewhere within its tolerance and take another placement",
    ),
    K.DISTANCE_ABOVE: (
        "the distance of sockets {numbers} in the fixture's file is {sigmas:TIMES} sigma above what the poses show",
        _DISTANCE,
    ),
    K.DISTANCE_BELOW: (
        "the distance of sockets {numbers} in the fixture's file is {sigmas:TIMES} sigma below what the poses show",
        _DISTANCE,
    ),
    K.ENDPOINTS_UNUSED: (
        "the poses have measured endpoints (x_m,y_m,z_m), which a {name} fixture does not use",
        "calibrate with a measured fixture, or use them in a comparison: sarcal verify --open-loop",
    ),
    K.NOT_IDENTIFIABLE: (
        "{reported}",
        "take poses that differ more from each other, or fix one of these parameters at its nominal value",
    ),
    K.NOT_REPEATED: (
        _NOT_REPEATED,
        (
            "let the capture run to its end, where it measures that pose (sarcal run --resume with this session), and "
            "calibrate again"
        ),
    ),
    K.NEVER_REPEATED: (
        _NOT_REPEATED,
        "verify the calibration with new poses (sarcal verify with this session)",
    ),
    # The solution.
    K.NOT_CONVERGED: (
        "the iteration did not converge in {iterations:d} rounds",
        "see the warnings about the readings, or try --global-start",
    ),
    K.OTHER_SOLUTION: (
        (
            "this is a local minimum ({name} {size:FAR_ANGLE|FAR_LENGTH} from nominal): another solution has a "
            "closure error {times:MANY_TIMES} times smaller"
        ),
        "calibrate with --global-start",
    ),
    K.FAR_FROM_NOMINAL: (
        "{name} is {size:FAR_ANGLE|FAR_LENGTH} from its nominal value",
        "check how the fixture is mounted and what the arm file states, or search everywhere with --global-start",
    ),
    K.SOCKET_ELSEWHERE: (
        "the ball's socket is not where the fixture's file states: {name} is {size:FAR_ANGLE|FAR_LENGTH} from there",
        "the calibration uses the position found from the poses; correct ground_mm in the file if the socket stays",
    ),
    K.SECOND_SOLUTION: ("{solutions:d} distinct solutions fit these poses equally well", _NEARER),
    K.PAPER_OFF: (
        (
            "{name} by the paper's estimator is {size:ANGLE_TOLERANCE|LENGTH_TOLERANCE} ({sigmas:MANY_TIMES} sigmas) "
            "from the estimate that weights every reading by its noise"
        ),
        "use --estimator implicit",
    ),
    K.PARALLEL_AXES: ("{reported}", "{reported_remedy}"),
    K.DIVERGED: (
        (
            "the solution diverged: it is far from what the files state, or its sigmas are useless. None of its "
            "figures describes the arm or the fixture"
        ),
        "remove the first cause and calibrate again",
    ),
    K.CHI2_EXCEEDS: (
        (
            "chi2/dof at stated noise is {size:CHI2}, where at most 1 is expected: some error exceeds its "
            "specification. The sigmas include its estimated size; the causes and the sources of error show which "
            "error it may be"
        ),
        "",
    ),
    K.FIXED_UNSEEN: (
        "{listed_all} cannot be identified from these poses and {one_name:was|were} fixed at nominal values{holds}",
        "",
    ),
    K.FIXED_BY_CHOICE: (
        "not calibrated but fixed, as stated in the arm's file: {fixed_at}{tolerance}{holds}",
        "",
    ),
    K.LENGTHS_EXACT: (
        (
            "the loops close only with a fixture that deflects, and link lengths were taken as exact; if the maker's "
            "lengths are not, the sigmas are too small"
        ),
        "calibrate again with --length-tolerance 1.5 (mm) and compare",
    ),
    K.SETUP_CHECK: ("{reported}", "{reported_remedy}"),
    K.LIMIT_SIGMA_POS: ("sigma_pos {size:POS_LIMIT} is above {limit:POS_LIMIT}", _DISTURBED),
    K.LIMIT_SIGMA_ORI: ("sigma_ori {size:ORI_LIMIT} is above {limit:ORI_LIMIT}", _DISTURBED),
    K.LIMIT_CHI2: (
        (
            "chi2/dof {size:CHI2} is above {limit:CHI2}: these readings exceed the specifications of the sensors and "
            "the fixture"
        ),
        _DISTURBED,
    ),
    # Sessions, reports and files.
    K.REPORTED: ("{reported}", "{reported_remedy}"),
    K.JOURNAL_TORN: ("{reported}: it held no accepted pose", ""),
    K.SOLVED_AGAIN: ("solved again for this report: {reported}", ""),
    K.NOT_CROSS_VALIDATED: (
        (
            "the hold-out test, which predicts parts of the poses from the rest, was not computed when this session "
            "was solved"
        ),
        "sarcal run --resume {name} computes it",
    ),
    K.CIRCULAR_TABLE: (
        "the RVDT table was made from these same poses: their closure says nothing about the sensor",
        "take new poses and correct their readings",
    ),
    # Comparisons of two calibrations.
    K.COMPARED_BACKWARDS: ("B is older than A: changes go backwards in time", "exchange the two"),
    K.COMPARED_SAME_POSES: (
        "A and B are from the same poses: any difference comes from the estimator, its options or the program",
        "",
    ),
    K.COMPARED_FIXTURE_KINDS: ("A used a {name} fixture, B a {last_name}", ""),
    K.COMPARED_FIXTURES: ("A used fixture {name}, B {last_name}", ""),
    K.COMPARED_ESTIMATORS: (
        "A was estimated by {name}, B by {last_name}: systematic sensor errors affect the two estimates differently",
        "",
    ),
    K.COMPARED_ENTRIES: (
        "A and B did not identify the same entries: an entry fixed in only one of them changes the other entries",
        "",
    ),
    K.COMPARED_CONSTANT: (
        (
            "{name} was taken as {a:ANGLE_4|LENGTH_4} in A and {b:ANGLE_4|LENGTH_4} in B: the other parameters "
            "compensate for it"
        ),
        "",
    ),
    K.COMPARED_REFUSED: ("{last_name} was {reported}", ""),
    K.COMPARED_SCALED: (
        "chi2/dof of {name} is {ratio:CHI2}: its standard deviations were multiplied by {size:CHI2}",
        "",
    ),
}
"""Text and remedy of each kind; the remedy is empty if the text is sufficient."""

BRIEF: Mapping[FindingKind, str] = {
    K.RVDT_VERDICT: "RVDT of joint {joint}: {name}",
    K.RVDT_HARMFUL: "RVDT of joint {joint}: {name}; treat joint {joint} as unsensed, or correct its readings",
}
"""Short texts of kinds with a long sentence."""

OWN_FORMATS = {
    "ANGLE": units.Kind(units.ANGLE, digits=2),
    "LENGTH": units.Kind(units.LENGTH, digits=2),
    "ANGLE_4": units.Kind(units.ANGLE, places=4),
    "LENGTH_4": units.Kind(units.LENGTH, places=4),
    "SIGMAS": units.Kind(units.NUMBER, digits=2),
}


class _Amount(float):
    """A value (SI units) that a template formats by the name of a `Kind`.

    ``A|B`` means A for angles and B for lengths.
    """

    angle: bool

    @classmethod
    def of(cls, value: float, unit: str) -> _Amount:
        """Return a value of a finding in this unit."""
        amount = cls(value)
        amount.angle = unit == "rad"
        return amount

    def __format__(self, spec: str) -> str:
        if spec == "d":
            return str(int(self))
        name = spec.split("|")[0 if self.angle else -1]
        kind = OWN_FORMATS.get(name) or getattr(units, name)
        return str(kind.not_zero(float(self)).with_unit)


class _Choice(int):
    """A flag; ``{certain:drifts|may drift}`` is the first text if it is true, else the second."""

    def __format__(self, spec: str) -> str:
        return spec.split("|")[not self]


class _Fields(dict[str, object]):
    """Mapping of the names that a template may use: a finding's figures, and FIELDS."""

    def __init__(self, found: Finding) -> None:
        figures = {"size": found.size, "sigma": found.sigma, **found.figures}
        super().__init__(
            {k: _Amount.of(v, found.unit) for k, v in figures.items() if v is not None}
        )
        self._found = found

    def __missing__(self, name: str) -> object:
        return FIELDS[name](self._found)


def fixed_briefly(found: tuple[str, ...]) -> str:
    """Return a note that names the fixed offsets on which the tool's accuracy depends."""
    return (
        f". It holds only if the fixed value of {names(found)} is right: see the warnings"
        if found
        else ""
    )


def _holds(f: Finding) -> str:
    """Return text on what the accuracy of the tool does not include; the figures of `f` are m/rad, by offset."""
    if not f.figures:
        return ""
    rates = (
        f"{Figure(rate * radians(1.0), CLOSURE_LENGTH).with_unit} rms for each degree of {name}"
        for name, rate in f.figures.items()
    )
    return _HOLDS_ONLY.format(fixed=", ".join(f.figures), rates=", ".join(rates))


def _displacement(f: Finding) -> str:
    turn, shift = f.figures["turn_rad"], f.figures["shift_m"]
    known = [(SHIFTED, shift), (TURNED, turn)]
    # Values that round to zero are left out if others do not.
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
    """Linearity deviation of an RVDT as a share of its full scale."""
    full = f.figures.get("full_scale_rad")
    if full is None or f.size is None or f.sigma is None:
        return ""
    peak, sd = (units.OF_FULL_SCALE(x / full).with_unit for x in (f.size, f.sigma))
    limit = units.LINEARITY(f.figures["linearity"]).with_unit
    return f" ({peak} of full scale, sigma {sd}; specification: at most {limit})"


def _shares(f: Finding) -> str:
    return "; ".join(
        f"{item.name}: {100.0 * (item.share or 0.0):.0f} % from these poses"
        + (f", sigma {_with_unit(item)}" if item.unit else "")
        for item in f.sizes
    )


def _tolerance(f: Finding) -> str:
    if f.size is None:
        return ""
    known = units.ANGLE_TOLERANCE(f.size).with_unit
    return f"; known within {known}, which the tool accuracy includes"


def _range(f: Finding) -> str:
    low, high = (units.SPAN(f.figures[name]) for name in ("lower_rad", "upper_rad"))
    return f"{low.shown} to {high.with_unit}"


def _narrowing(f: Finding) -> str:
    if f.names:
        return source_remedy(f.names[0])
    return "take more poses that differ more from each other: every joint through a larger part of its range"


FIELDS: Mapping[str, Callable[[Finding], object]] = {
    "certain": lambda f: _Choice(f.certain),
    "several": lambda f: _Choice(len(f.poses) > 1),
    "one": lambda f: _Choice(f.size == 1),
    "one_name": lambda f: _Choice(len(f.names) == 1),
    "joint": lambda f: f.joint,
    "joints": lambda f: joints_named(f.joints),
    "sensor_name": lambda f: "RVDT" if f.sensor == "RVDT" else "encoder",
    "poses": lambda f: poses_named(f.poses),
    "first": lambda f: f.poses[0],
    "last": lambda f: f.poses[-1],
    "between": lambda f: f"between pose {f.poses[0]} and pose {f.poses[1]}",
    "since": lambda f: f.poses[1],
    "placement": lambda f: f" of placement {f.joints[0]}" if f.joints else "",
    "outlying": lambda f: "may" if not f.certain else "do" if len(f.poses) > 1 else "does",
    "name": lambda f: f.names[0],
    "last_name": lambda f: f.names[-1],
    "listed": lambda f: ", ".join(f.names[:LISTED]),
    "listed_all": lambda f: ", ".join(f.names),
    "numbers": lambda f: names(f.joints),
    "tests": lambda f: ", ".join(f.names),
    "degrees": lambda f: f"{int(f.size or 0)} degree{'s' * (f.size != 1)}",
    "sizes": lambda f: ", ".join(f"{x.name} ({_with_unit(x)})" for x in f.sizes[:LISTED]),
    "fixed_at": lambda f: ", ".join(
        f"{x.name} at {units.NOMINAL_OFFSET(x.size).with_unit}" for x in f.sizes
    ),
    "reference": lambda f: "best line" if "from_line" in f.figures else "true angle",
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
}
