"""Kinds of findings, each with its public code, text and remedy; no other module contains such texts.

A message is a template. ``{size:STEP}`` is the value `size` in the format STEP of `operator_app.units`.
``{limit:ANGLE|LENGTH}`` is `limit` in the format ANGLE if the finding's unit is rad, otherwise in the format LENGTH.
``{certain:drifts|may drift}`` becomes "drifts" if the finding is certain, otherwise "may drift".
``{several:do|does}`` becomes "do" if the finding is about several poses, otherwise "does".
"""

# Several kinds may have the same code and text.
# ruff: noqa: PIE796
from enum import Enum
from typing import NamedTuple, Self

_STATE_GIVE = "state its compliance in the fixture file (key give: position_mm, orientation_mrad)"
_FIX_BOLTS = f"tighten its bolts and check for play; otherwise {_STATE_GIVE}"
_ENDPOINT_ERRORS = "the instrument, the arm's base or the target moves, or the arm has an error that no file states"
_FIX_INSTRUMENT = (
    "fasten instrument, arm and target and check them for play; if nothing moves, state a larger instrument_sigma_mm "
    "(or instrument_sigma_deg) in the fixture file, or larger errors in the arm file"
)
_UNSENSED = "calibrate with --unsensed {joint}"
_REPEAT_JOINT = (
    "check the coupling and cable of joint {joint}'s sensor (count loss, a slipped coupling), home the joint and "
    "take all poses again"
)
_RANGE = (
    "joint {joint} reads {size:READING} in {poses}, outside its range {range}",
    "check whether these readings were corrupted, or correct range_deg in the arm file",
)
_WHOLE_TURN = (
    (
        "joint {joint} reads {size:READING} in {poses}, outside its range {range} by whole turns: its turn count "
        "is wrong"
    ),
    "home the joint or correct range_deg in the arm file",
)
_SATURATED = (
    (
        "in {poses} joint {joint} reads {size:READING}, the end of its sensor's full scale ({range}): every angle "
        "beyond it gives the same reading"
    ),
    "take these poses closer to the middle of the sensor's range, or exclude them",
)
_TOGETHER = (
    "check that arm file, fixture file and poses belong together; find out what was changed between the poses; try "
    "--global-start"
)
_DISTANCE = (
    "check that every pose has the number of its socket (files given in another order?), then measure the distance "
    "again and correct the fixture file: an error in this distance scales all lengths of the arm"
)
_DISTURBED = (
    "take more poses, look for a pose that was disturbed, or calibrate without the readings of the joint that the "
    "warnings name (--unsensed)"
)
_NOT_REPEATED = (
    "pose {first}{placement} was not measured again after the last pose, {last} ({reported}): a slip of a joint or "
    "the fixture after pose {since} shows only in how well the poses fit, and one during the last poses hardly at all"
)


class _Message(NamedTuple):
    code: str
    text: str
    remedy: str = ""
    brief: str = ""


class FindingKind(Enum):
    """Kind of a finding.

    Attributes
    ----------
    code
        Pattern of the public code (JSON, journals, API), which never changes; kinds with different texts may share it.
    text, remedy
        Templates of its message; the remedy is empty if the text is sufficient.
    brief
        Template of a short form for a small panel, if the sentence is long.
    """

    code: str
    text: str
    remedy: str
    brief: str

    def __new__(cls, code: str, text: str, remedy: str = "", brief: str = "") -> Self:
        """Make a member whose value is a unique number, because Enum merges members with equal values."""
        member = object.__new__(cls)
        member._value_ = len(cls.__members__)
        member.code, member.text, member.remedy, member.brief = code, text, remedy, brief
        return member

    # Faults of fixture, arm and sensors.
    FIXTURE_SLIPPED = _Message(
        "SLIP_FIXTURE",
        text="the fixture {certain:slipped|may have slipped} on the {name} by about {displacement} {between}",
        remedy="tighten it on the {name} and take all poses again; or use either the poses up to pose {first} or "
        "those from pose {last} on",
    )
    FIXTURE_DEFLECTS_MORE = _Message(
        "FIXTURE_GIVES",
        text="the fixture {certain:deflects|may deflect} by about {displacement}, more than its file states",
        remedy=_FIX_BOLTS,
    )
    FIXTURE_DEFLECTS_OTHERWISE = _Message(
        "FIXTURE_GIVES",
        text="the fixture {certain:moves|may move} by about {displacement}, without a consistent relation to load "
        "or pose",
        remedy=_FIX_BOLTS,
    )
    FIXTURE_TURNS_RANDOMLY = _Message(
        "FIXTURE_GIVES",
        text="the fixture turns by about {size:DEFLECTION_ANGLE} at random from pose to pose, {times:TIMES} times "
        "what its file states",
        remedy=_FIX_BOLTS,
    )
    FIXTURE_SHIFTS_RANDOMLY = _Message(
        "FIXTURE_GIVES",
        text="the fixture shifts by about {size:DEFLECTION_LENGTH} at random from pose to pose, {times:TIMES} "
        "times what its file states",
        remedy=_FIX_BOLTS,
    )
    INSTRUMENT_MOVED = _Message(
        "SLIP_FIXTURE",
        text="the instrument or the arm's base {certain:moved|may have moved} by about {displacement} {between}",
        remedy="check that instrument and arm stand firmly and take all poses again; or use either the poses up to "
        "pose {first} or those from pose {last} on",
    )
    TARGET_MOVED = _Message(
        "SLIP_FIXTURE",
        text="the target {certain:moved|may have moved} on the tool by about {displacement} {between}",
        remedy="fasten the target and take all poses again; or use either the poses up to pose {first} or those from "
        "pose {last} on",
    )
    INSTRUMENT_DEFLECTS_MORE = _Message(
        "FIXTURE_GIVES",
        text="measured and calculated endpoints {certain:differ|may differ} by about {displacement} from pose to "
        "pose, more than the fixture file states; " + _ENDPOINT_ERRORS,
        remedy=_FIX_INSTRUMENT,
    )
    INSTRUMENT_DEFLECTS_OTHERWISE = _Message(
        "FIXTURE_GIVES",
        text="measured and calculated endpoints {certain:differ|may differ} by about {displacement}, without a "
        "consistent relation to load or pose; " + _ENDPOINT_ERRORS,
        remedy=_FIX_INSTRUMENT,
    )
    INSTRUMENT_TURNS_RANDOMLY = _Message(
        "FIXTURE_GIVES",
        text="the measured orientations scatter by about {size:TURNED} at random from pose to pose, "
        "{times:TIMES} times what the fixture file states",
        remedy=_FIX_INSTRUMENT,
    )
    INSTRUMENT_SHIFTS_RANDOMLY = _Message(
        "FIXTURE_GIVES",
        text="the measured points scatter by about {size:DEFLECTION_LENGTH} at random from pose to pose, "
        "{times:TIMES} times what the fixture file states",
        remedy=_FIX_INSTRUMENT,
    )
    WRONG_FIXTURE_HINGE = _Message(
        "WRONG_FIXTURE",
        text="the loops close like those of a hinge, not of a {name} fixture",
        remedy="calibrate with the fixture file of that hinge; this command writes that file from these poses: "
        "{last_name}",
    )
    WRONG_FIXTURE_BALL = _Message(
        "WRONG_FIXTURE",
        text="the loops close like those of a ball that turns freely, not of a {name} fixture",
        remedy="find why the fixture can tilt; or, if it is a ball, calibrate with the fixture file of that ball "
        "and with --drop-unidentifiable (with a ball, the first joint's offset is not separable from the socket's "
        "place); this command writes that file from these poses: {last_name}",
    )
    READING_STEP = _Message(
        "STEP_JOINT_{joint}",
        text="the reading of joint {joint} {certain:shifted|may have shifted} by {size:STEP}{in_counts} {between}",
        remedy=_REPEAT_JOINT,
    )
    READING_JUMP = _Message(
        "STEP_JOINT_{joint}",
        text="the reading of joint {joint} {certain:jumped|may have jumped} by {size:TARGET}{in_counts} {between}: "
        "its node restarted or its sensor came off",
        remedy="home joint {joint} and take all poses again",
    )
    READING_OR_TARGET_STEP = _Message(
        "STEP_JOINT_{joint}",
        text="the reading of joint {joint} {certain:shifted|may have shifted} by {size:STEP}{in_counts}, or the "
        "target turned on the flange by as much, {between}",
        remedy="check whether the target is fastened and fasten it; otherwise " + _REPEAT_JOINT,
    )
    READING_DRIFT = _Message(
        "DRIFT_JOINT_{joint}",
        text="the reading of joint {joint} {certain:drifts|may drift} by about {size:STEP} from the first pose to "
        "the last",
        remedy="let arm and electronics warm up, check the coupling of joint {joint}'s sensor, then take all poses "
        "again",
    )
    READING_NOISE = _Message(
        "{sensor}_{joint}",
        text="the reading of joint {joint} {certain:scatters|may scatter} by {size:SCATTER}{specified}",
        remedy="check the sensor and cable of joint {joint}, or " + _UNSENSED,
    )
    READING_UNRELATED = _Message(
        "{sensor}_{joint}",
        text="the reading of joint {joint} {certain:does|possibly does} not follow the joint's angle as computed from "
        "the closed loop",
        remedy="check the sensor, cable and channel of joint {joint}; until then " + _UNSENSED,
    )
    READING_FROZEN = _Message(
        "FROZEN_JOINT_{joint}",
        text="the sensor of joint {joint} {certain:reads|may read} the same from pose {first} to pose {last}, "
        "while the loop shows that the joint moved",
        remedy="check the sensor and cable of joint {joint}, then take these poses again; or "
        + _UNSENSED,
    )
    MOTION_DURING_SAMPLING = _Message(
        "UNSTEADY_{joint}",
        text="the readings of joint {joint} spread by up to {size:SCATTER} within {poses}, more than the noise of "
        "its {sensor_name}: the joint moved or vibrated during sampling",
        remedy="wait until the arm has settled, check for vibration, and take these poses again",
    )
    ALL_READINGS_NOISE = _Message(
        "SCATTER",
        text="the readings of all joints {certain:scatter|may scatter} by about {size:SCATTER} from pose to pose, "
        "more than the noise of their sensors: vibration, play, or an arm that had not settled",
        remedy="wait longer before each pose and average more samples, check for vibration and loose couplings, "
        "then take all poses again",
    )
    ENCODER_SCALE = _Message(
        "SCALE_{joint}",
        text="the scale of joint {joint}'s encoder {certain:is|may be} off by about {size:OFF_SCALE}",
        remedy="check counts_per_rev and the gear ratio of joint {joint} in arm file and drive, then take all "
        "poses again",
    )
    ENCODER_CYCLIC_ERROR = _Message(
        "{sensor}_{joint}",
        text="the encoder of joint {joint} {certain:has|may have} a cyclic error of {size:SCATTER} rms with one or "
        "two periods per turn, more than its accuracy_deg allows",
        remedy="check the centring of joint {joint}'s encoder, or state a larger accuracy_deg",
    )
    ENCODERS_EXCEED = _Message(
        "ENCODERS",
        text="the errors of the encoders are about {times:TIMES} times their accuracy_deg",
        remedy="check the centring of the encoders, or state a larger accuracy_deg",
    )
    RVDT_NONLINEAR = _Message(
        "{sensor}_{joint}",
        text="the RVDT of joint {joint} {certain:deviates|may deviate} from its {reference} by up to "
        "{size:DEVIATION}{share}",
        remedy="replace or linearise the RVDT of joint {joint}, or " + _UNSENSED,
    )
    RVDT_NOISE_EXCEEDS = _Message(
        "{sensor}_{joint}",
        text="the readings of joint {joint}'s RVDT scatter about {times:TIMES} times as much as specified",
        remedy="check the plug, screen and excitation of this RVDT, or " + _UNSENSED,
    )
    RVDT_LINEARITY_EXCEEDS = _Message(
        "{sensor}_{joint}",
        text="the linearity deviation of joint {joint}'s RVDT is about {times:TIMES} times as large as specified",
        remedy="replace or linearise this RVDT, or " + _UNSENSED,
    )
    RVDT_GAIN_EXCEEDS = _Message(
        "{sensor}_{joint}",
        text="the gain of joint {joint}'s RVDT deviates from nominal by about {times:TIMES} times the specified "
        "tolerance",
        remedy="have its scale factor adjusted, state a larger tolerance of its gain, or "
        + _UNSENSED,
    )
    RVDT_VERDICT = _Message(
        "{sensor}_{joint}", text="{reported}", brief="RVDT of joint {joint}: {name}"
    )
    RVDT_HARMFUL = _Message(
        "{sensor}_{joint}",
        text="{reported}",
        brief="RVDT of joint {joint}: {name}; treat joint {joint} as unsensed, or correct its readings",
    )
    RVDT_OUT_LINEARITY = _Message(
        "{sensor}_{joint}", text="{reported}", remedy="replace or linearise it, or " + _UNSENSED
    )
    RVDT_OUT_SPREAD = _Message(
        "{sensor}_{joint}",
        text="{reported}",
        remedy="check whether the spread of its readings is as recorded (sd{joint}_deg), or "
        + _UNSENSED,
    )
    RVDT_OUT_NOISE = _Message(
        "{sensor}_{joint}", text="{reported}", remedy="find what disturbs it, or " + _UNSENSED
    )
    JOINT_SAG = _Message(
        "SAG_JOINT_{joint}",
        text="joint {joint} {certain:sags|may sag} by {size:SCATTER} rms, depending on the pose, more than its "
        "sag_deg in the arm file allows for",
        remedy="check joint {joint} for play or a compliant link, or state a larger sag_deg",
    )
    PLAY_EXCEEDS = _Message(
        "PLAY",
        text="the joints' play is about {times:TIMES} times their backlash_deg",
        remedy="check bearings and couplings for wear, or state a larger backlash_deg",
    )
    SAG_EXCEEDS = _Message(
        "SAG",
        text="the joints' sag under load is about {times:TIMES} times their sag_deg",
        remedy="check bearings and couplings for wear, or state a larger sag_deg",
    )
    LENGTH_STEP = _Message(
        "STEP_LENGTH_{name}",
        text="{name} {certain:changed|may have changed} by {size:GREW} {between}",
        remedy="check for a loose joint or link at {name}, then take all poses again",
    )
    LENGTH_OFF = _Message(
        "LENGTH_{name}",
        text="{name} {certain:differs|may differ} from the arm file by about {size:OFF_LENGTH} (tolerance "
        "{limit:LENGTH_TOLERANCE})",
        remedy="measure {name} and correct the arm file, or state a larger tolerance for its row",
    )
    TWIST_OFF = _Message(
        "TWIST_{name}",
        text="{name} {certain:differs|may differ} from the arm file by about {size:TARGET} (tolerance "
        "{limit:ANGLE_TOLERANCE})",
        remedy="measure {name} and correct the arm file, or state a larger tolerance for its row",
    )
    LENGTHS_EXCEED = _Message(
        "LENGTHS",
        text="the arm's lengths differ from its file by about {times:TIMES} times the stated tolerance",
        remedy="measure the arm and correct the file, or state a larger tolerance for its lengths",
    )
    TWISTS_EXCEED = _Message(
        "TWISTS",
        text="the arm's twists differ from its file by about {times:TIMES} times the stated tolerance",
        remedy="measure the arm and correct the file, or state a larger tolerance for its twists",
    )
    REPEAT_FIXTURE_MOVED = _Message(
        "RETURN_FIXTURE",
        text="the fixture moved by about {displacement}, more than its file states, between pose {first} and its "
        "repeat measurement after {after:d} poses",
        remedy="tighten its bolts and check for play, then take all poses again; otherwise "
        + _STATE_GIVE,
    )
    REPEAT_READING_STEP = _Message(
        "RETURN_JOINT_{joint}",
        text="the reading of joint {joint} shifted by {size:POSITION} (sigma {sigma:SLIP_SIGMA}) between pose "
        "{first} and its repeat measurement after {after:d} poses",
        remedy=_REPEAT_JOINT,
    )
    UNEXPLAINED_SCATTER = _Message(
        "UNNAMED",
        text="the readings scatter {times:TIMES} times as much as the files state and no single fault explains it",
        remedy=f"{_TOGETHER}; if the files state smaller errors than this arm has, state larger ones",
    )
    UNEXPLAINED_PATTERN = _Message(
        "UNNAMED",
        text="the readings scatter no more than the files state, but their pattern is not due to chance "
        "(significant tests: {listed_all}), and no single fault explains it",
        remedy=_TOGETHER,
    )
    POSES_DO_NOT_FIT = _Message(
        "UNNAMED",
        text="these poses do not fit this arm and fixture: the readings scatter {times:TIMES} times as much as the "
        "files state, and no fault of a joint, a length or a pose explains it",
        remedy="check whether the poses belong to another arm or fixture, or were taken before a change of this "
        "arm; find out what was changed between the poses; try --global-start",
    )

    # Mistakes in files.
    READING_MISTAKE = _Message(
        "{name}", text="{reported}, and the loops close", remedy="{reported_remedy}"
    )
    OFFSETS_IN_RADIANS = _Message(
        "RADIANS_OFFSETS",
        text="the loops close if theta_off_deg of the arm file is taken as radians",
        remedy="angles in an arm file are in deg: multiply its theta_off_deg by 57.29578",
    )
    ZERO_TURNED = _Message(
        "ZERO_JOINT_{joint}",
        text="the loops close if theta_off_{joint} of the arm file is changed by {size:TARGET}",
        remedy="correct theta_off_{joint} in the arm file, or set the zero of joint {joint}'s sensor",
    )
    ENTRIES_EXCHANGED = _Message(
        "EXCHANGED_{names}",
        text="the loops close if {name} and {last_name} of the arm file are exchanged",
        remedy="measure {name} and {last_name} and correct the arm file",
    )
    OUT_OF_RANGE = _Message("RANGE_{joint}", *_RANGE)
    OUT_OF_RANGE_NOTICE = _Message("RANGE", *_RANGE)
    WHOLE_TURN_OFF = _Message("RANGE_{joint}", *_WHOLE_TURN)
    WHOLE_TURN_OFF_NOTICE = _Message("RANGE", *_WHOLE_TURN)
    SATURATED = _Message("SATURATED_{joint}", *_SATURATED)
    SATURATED_NOTICE = _Message("RANGE", *_SATURATED)
    POSES_IN_RADIANS = _Message(
        "RANGE_RADIANS",
        text="{poses} {several:are|is} outside the arm's ranges if read as degrees but inside if read as radians, "
        "and {several:were|was} left out",
        remedy="multiply the angles of {several:these rows|this row} by 57.29578",
    )
    POSE_OUT_OF_RANGE = _Message(
        "RANGE_POSE",
        text="{poses} was left out: its readings of {joints} are outside the joint ranges",
        remedy="correct that row, take the pose again or remove it",
    )

    # Poses.
    POSES_FLIPPED = _Message(
        "FLIPPED_BRANCH",
        text="{poses} ({count:d} of {of:d} poses) {several:close|closes} only with the tool upside down on the "
        "hinge and {several:were|was} left out",
        remedy="take {several:them|it} again with the tool the right way up, or remove {several:them|it}",
    )
    REPEATED_ROWS = _Message(
        "REPEATED_ROWS",
        text="{count:d} of {of:d} rows repeat another, because no joint had moved in between: they count as "
        "{distinct:d} poses",
        remedy="if these rows are a recording of an arm in motion, import it with --time COLUMN",
    )
    OUTLIERS = _Message(
        "OUTLIERS",
        text="{poses} {outlying} not fit the others",
        remedy="find what disturbed {several:them|it}, exclude {several:them|it} and calibrate again",
    )
    OUTLIERS_COUNT = _Message(
        "OUTLIER",
        text="{poses} {several:do|does} not fit the others and {several:are|is} still used",
        remedy="find what disturbed {several:them|it}, then decide whether to exclude {several:them|it}",
    )
    TOO_FEW_POSES = _Message(
        "TOO_FEW_POSES",
        text="the fit has only {degrees} of freedom, too few to tell whether anything is wrong",
        remedy="take at least 20 poses",
    )
    SIGMAS_USELESS = _Message(
        "LITTLE_MOTION",
        text="these poses hardly determine {sizes}; standard uncertainties are in brackets",
        remedy="{narrowing}",
    )
    SIGMAS_WIDE = _Message(
        "LITTLE_MOTION",
        text="these standard uncertainties are large: {sizes}",
        remedy="{narrowing}",
    )
    CONDITION = _Message(
        "CONDITION",
        text="scaled condition number {size:CONDITION} is above {limit:CONDITION} (weakest direction: {listed})",
        remedy="poses that differ more from each other would give smaller sigmas",
    )
    KNOWN_BY_FILES = _Message(
        "AS_STATED", text="the files determine these parameters more than the poses do: {shares}"
    )
    SAME_PLACEMENT = _Message(
        "SAME_PLACEMENT",
        text="placements {numbers} of the fixture do not differ clearly (largest difference: {name}, "
        "{size:ANGLE_TOLERANCE|LENGTH_TOLERANCE}, {sigmas:SIGMAS} sigma): probably the fixture was not remounted "
        "between them, or was remounted in the same place; together they give hardly more information than one "
        "placement",
        remedy="mount the fixture elsewhere within its tolerance and take another placement",
    )
    DISTANCE_ABOVE = _Message(
        "DISTANCE",
        text="the fixture file's distance between sockets {numbers} is {sigmas:TIMES} sigma above the poses' "
        "estimate",
        remedy=_DISTANCE,
    )
    DISTANCE_BELOW = _Message(
        "DISTANCE",
        text="the fixture file's distance between sockets {numbers} is {sigmas:TIMES} sigma below the poses' "
        "estimate",
        remedy=_DISTANCE,
    )
    DISTANCE_UNUSED = _Message(
        "DISTANCE_UNUSED",
        text="the fixture file's measured distances between these sockets are not used: {listed_all} (placements with "
        "poses: {numbers})",
        remedy="correct the numbers in the fixture file (key between) or in the column placement of the poses",
    )
    ENDPOINTS_SHIFTED = _Message(
        "ENDPOINTS_SHIFTED",
        text="the measured endpoint of each pose is in the file one row {name}: the instrument's data lack a row or "
        "have one too many",
        remedy="assign the endpoints to the poses by their times",
    )
    ENDPOINTS_UNUSED = _Message(
        "ENDPOINTS_UNUSED",
        text="the poses have measured endpoints (x_m,y_m,z_m), which a {name} fixture does not use",
        remedy="calibrate with a measured fixture, or use them in a comparison: sarcal verify --open-loop",
    )
    NOT_IDENTIFIABLE = _Message(
        "UNSEEN",
        text="{reported}",
        remedy="take poses that differ more from each other, or fix one of these parameters at its nominal value",
    )
    NOT_REPEATED = _Message(
        "NO_RETURN",
        text=_NOT_REPEATED,
        remedy="let the capture run to its end, where it measures that pose again (sarcal run --resume with this "
        "session), and calibrate again",
    )
    NEVER_REPEATED = _Message(
        "NO_RETURN",
        text=_NOT_REPEATED,
        remedy="verify the calibration with new poses (sarcal verify with this session)",
    )

    # The solution.
    NOT_CONVERGED = _Message(
        "NOT_CONVERGED",
        text="the iteration did not converge in {iterations:d} iterations",
        remedy="see the warnings about the readings, or try --global-start",
    )
    OTHER_SOLUTION = _Message(
        "OTHER_SOLUTION",
        text="this is a local minimum ({name} {size:FAR_ANGLE|FAR_LENGTH} from nominal): another solution has a "
        "closure error {times:MANY_TIMES} times smaller",
        remedy="calibrate with --global-start",
    )
    FAR_FROM_NOMINAL = _Message(
        "FAR_FROM_NOMINAL",
        text="{name} is {size:FAR_ANGLE|FAR_LENGTH} from its nominal value",
        remedy="check how the fixture is mounted and what the arm file states, or search everywhere with "
        "--global-start",
    )
    SOCKET_ELSEWHERE = _Message(
        "SOCKET_ELSEWHERE",
        text="the ball's socket is not where the fixture's file states: {name} differs by "
        "{size:FAR_ANGLE|FAR_LENGTH}",
        remedy="the calibration uses the position found from the poses; if it is right, correct ground_mm in the "
        "fixture's file; if the file's position is right, all lengths of the arm file are wrong by one factor: "
        "measure the distance between two sockets to find out",
    )
    FIXTURE_ELSEWHERE = _Message(
        "FIXTURE_ELSEWHERE",
        text="the fixture's {name} differs from its file by {size:FAR_ANGLE|FAR_LENGTH}",
        remedy="the calibration uses the value found from the poses; if the fixture stays there, correct its file",
    )
    OFFSET_FAR = _Message(
        "OFFSET_TOLERANCE",
        text="{name} differs from the arm file by {size:FAR_ANGLE}, {times:TIMES} times its offset_tolerance_deg",
        remedy="check the zero of joint {joint}; if it is right, correct the offset or the tolerance in the arm file",
    )
    SECOND_SOLUTION = _Message(
        "SECOND_SOLUTION",
        text="{solutions:d} distinct solutions fit these poses equally well",
        remedy="take more poses that differ more from each other, or state nominal values closer to the true ones",
    )
    PAPER_OFF = _Message(
        "PAPER_OFF",
        text="{name} from the paper's estimator differs by {size:ANGLE_TOLERANCE|LENGTH_TOLERANCE} "
        "({sigmas:MANY_TIMES} sigmas) from the estimate that weights every reading by its noise",
        remedy="use the implicit estimator (--estimator implicit; e in the app)",
    )
    PARALLEL_AXES = _Message("PARALLEL_AXES", text="{reported}", remedy="{reported_remedy}")
    DIVERGED = _Message(
        "ASTRAY",
        text="the solution diverged: it is far from what the files state, or its sigmas are useless. None of its "
        "figures describes the arm or the fixture",
        remedy="remove the first cause listed and calibrate again",
    )
    CHI2_EXCEEDS = _Message(
        "CHI2",
        text="chi2/dof at stated noise is {size:CHI2}, where at most 1 is expected: some error exceeds its "
        "specification. The sigmas include the estimated size of that error; the causes and the sources of error "
        "show which error it may be",
    )
    FIXED_UNSEEN = _Message(
        "HELD",
        text="{listed_all} cannot be identified from these poses and {one_name:was|were} fixed at nominal "
        "values, which the sigmas of the other parameters take as exact{holds}",
        remedy="{releasing}",
    )
    FIXED_BY_CHOICE = _Message(
        "HELD",
        text="the arm file or the procedure fixes {fixed_at}; the sigmas of the other parameters assume that these "
        "values are exact{tolerance}{holds}",
        remedy="{releasing}",
    )
    LENGTHS_EXACT = _Message(
        "LENGTHS_EXACT",
        text="the loops close only with a fixture that deflects, and link lengths were taken as exact; if they "
        "differ from the arm file, the sigmas are too small",
        remedy="calibrate again with --length-tolerance 1.5 (mm) and compare",
    )
    SETUP_CHECK = _Message("{name}", text="{reported}", remedy="{reported_remedy}")
    LIMIT_SIGMA_POS = _Message(
        "SIGMA_POS_LIMIT",
        text="sigma_pos {size:POS_LIMIT} is above {limit:POS_LIMIT}",
        remedy=_DISTURBED,
    )
    LIMIT_SIGMA_ORI = _Message(
        "SIGMA_ORI_LIMIT",
        text="sigma_ori {size:ORI_LIMIT} is above {limit:ORI_LIMIT}",
        remedy=_DISTURBED,
    )
    LIMIT_CHI2 = _Message(
        "CHI2_LIMIT",
        text="chi2/dof {size:CHI2} is above {limit:CHI2}: these readings exceed the specifications of the sensors "
        "and the fixture",
        remedy=_DISTURBED,
    )

    # Sessions, reports and files.
    REPORTED = _Message("{name}", text="{reported}", remedy="{reported_remedy}")
    JOURNAL_TORN = _Message("TORN", text="{reported}; it contained no accepted pose")
    SOLVED_AGAIN = _Message(
        "SOLVED_AGAIN", text="the poses were solved again for this report: {reported}"
    )
    NOT_CROSS_VALIDATED = _Message(
        "UNCHECKED",
        text="the hold-out test, which predicts parts of the poses from the rest, was not computed when this "
        "session was solved",
        remedy="sarcal run --resume {name} computes it",
    )
    CIRCULAR_TABLE = _Message(
        "CIRCULAR_TABLE",
        text="the RVDT table was made from these same poses: their closure error says nothing about the sensor",
        remedy="take new poses and correct their readings with this table",
    )

    # Comparisons of two calibrations.
    COMPARED_BACKWARDS = _Message(
        "ORDER", text="B is older than A: changes go backwards in time", remedy="exchange A and B"
    )
    COMPARED_SAME_POSES = _Message(
        "SAME_POSES",
        text="A and B are from the same poses: any difference comes from the estimator, its options or the program",
    )
    COMPARED_FIXTURE_KINDS = _Message(
        "FIXTURE_KIND", text="A used a {name} fixture, B a {last_name} fixture"
    )
    COMPARED_FIXTURES = _Message(
        "FIXTURE", text="A used the fixture '{name}', B the fixture '{last_name}'"
    )
    COMPARED_ESTIMATORS = _Message(
        "ESTIMATOR",
        text="A was estimated with '{name}', B with '{last_name}': systematic sensor errors affect the two "
        "differently",
    )
    COMPARED_ENTRIES = _Message(
        "ENTRIES",
        text="A and B did not identify the same entries: an entry fixed in only one of them changes the other "
        "entries",
    )
    COMPARED_CONSTANT = _Message(
        "TABLE",
        text="{name} was taken as {a:ENTRY_ANGLE|ENTRY_LENGTH} in A and {b:ENTRY_ANGLE|ENTRY_LENGTH} in B: the other "
        "parameters compensate for the difference",
    )
    COMPARED_REFUSED = _Message("{name}", text="{last_name} was {reported}")
    COMPARED_SCALED = _Message(
        "CHI2",
        text="chi2/dof of {name} is {ratio:CHI2}: its standard deviations were multiplied by {size:CHI2}",
    )
