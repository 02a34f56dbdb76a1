"""Limits by which a calibration is assessed, each with its reason.

A name states quantity and unit. Angles are in rad, lengths in m, shares are fractions of 1.
"""

import numpy as np

# Probabilities of a false alarm, per test or family of tests

FALSE_ALARM_PROBABILITY = 1e-3
"""Probability that a test, or any test of a family (all poses, joints, entries), fires although there is no fault."""

ENTRY_SUSPICION_PROBABILITY = 0.1
"""False-alarm probability of the tests that only report suspected lengths and twists. It is large because an error of a
few tolerances spoils a calibration before any test can be certain of the error."""

CHI2_BAND_PROBABILITY = 0.99
"""chi2/dof outside the central band of this probability contradicts the noise model."""

CHI2_NOTICE_PROBABILITY = 0.01
"""A chi2 at stated noise that is less likely than this is reported."""

DISTANCE_NOTICE_PROBABILITY = 0.01
"""Probability of reporting any measured distance between sockets although distances and poses have no fault."""

OUTLIER_NOTICE_PROBABILITY = 0.01
"""Probability of reporting any pose of a pose set without a fault as an outlier."""

DRIFT_FALSE_ALARM_PROBABILITY = 0.01
"""Probability that two calibrations of an unchanged arm are reported to differ in any parameter."""

CONTROL_CHART_FALSE_ALARM_PROBABILITY = 0.0017
"""Probability of a false alarm in one session. The probability of any false alarm in 12 sessions is 1 %, or 5 % if the
scatters of the sessions differ by 35 %."""

CURVATURE_FALSE_ALARM_PROBABILITY = 0.01
"""Probability of reporting a linear RVDT as curved."""

REMOUNT_FALSE_ALARM_PROBABILITY = 1e-6
"""The fixture counts as remounted between two placements if differences as large as the observed ones are less probable
than this with an untouched fixture."""

REPEAT_REFUSAL_PROBABILITY = 1e-4
"""The calibration is refused if the repeat of a pose is less probable than this, however large the sigmas are: the slip
of the fixture that the repeat shows may itself have made the sigmas large."""

# Probabilities of a cause

LEAST_REPORTED_CAUSE_PROBABILITY = 0.02
"""Causes of a lower probability are not reported."""

EQUALLY_GOOD_CHI2 = 9.2
"""Two explanations count as equally good if their chi2 differs by less than this, a factor of 100 in likelihood."""

POSSIBLE_CAUSE_PROBABILITY = 0.1
"""The sigmas have to cover every cause whose probability is at least this, not only the most probable cause."""

# Misfit: chi2/dof at stated variances, and ratios of it

CHI2_PER_DOF_SECOND_START = 2.0
"""A fit with a larger chi2/dof is repeated from another start. If the poses differ little from each other, a fit in a
wrong optimum may have a chi2/dof as small as this."""

CHI2_PER_DOF_EXPLAINED = 2.0
"""A cause counts as the whole explanation if chi2/dof is at most this once the cause is fitted."""

CHI2_PER_DOF_ALTERNATIVE = 3.0
"""An alternative model explains a gross misfit if its own chi2/dof is at most this."""

CHI2_PER_DOF_REFUSED = 4.0
"""With a larger chi2/dof no sigma is valid. At this limit the scatter is twice the stated one: the result will change
once the fault is repaired, whether or not the fault was reported."""

CHI2_PER_DOF_GROSS = 30.0
"""A fit with a larger chi2/dof gives no information about its readings, and no second cause is searched for."""

ALTERNATIVE_CHI2_RATIO = 10.0
"""An alternative model has to reduce chi2/dof by at least this factor."""

SMALLEST_NOISE_SCALE = 0.25
"""Smallest factor by which variances are scaled. Factors below 1 occur because stated errors are upper limits, so that
pose sets without a fault have chi2/dof below 1."""

OTHER_START_MISFIT_SHARE = 0.5
"""The fit from a second start replaces the first fit if its misfit is below this share of the first fit's."""

OTHER_SOLUTION_COST_SHARE = 0.5
"""Another solution is better if its squared closure error is below this share of the present solution's."""

POSE_CHI2_UNPREDICTED = 20.0
"""A new pose with a larger chi2 contradicts its prediction from earlier poses. Among 3,000 poses of arms without a
fault, the largest chi2 was 10."""

POSE_CHI2_RATIO_UNPREDICTED = 6.0
"""A new pose counts as unpredicted only if its chi2 is also more than this many times the largest chi2 of the earlier
poses, which is large if errors exceed the stated ones. After an unpredicted pose, a session repeats the first. This
happened in 4 of 100 planned sessions without a fault if errors were three times the stated ones, otherwise never."""

# Sigmas and ratios of standard deviations

CERTAIN_SIGMAS = 3.0
"""A deviation counts as larger than a specification if it is larger by more than this many sigmas of the deviation."""

REFUSING_SHIFT_SIGMAS = 2.0
"""A cause that moves a parameter by more than this many sigmas of the parameter shows that sigmas are not valid."""

MOST_COMPLIANCE_RAD = np.deg2rad(1.0)
MOST_COMPLIANCE_M = 0.01
"""Largest credible deflection (rms) of a fixture. A larger deflection is not accepted as a cause, because it would
explain any misfit."""

USELESS_SIGMA_RAD = np.deg2rad(10.0)
USELESS_SIGMA_M = 0.03
"""Uncertainty of a parameter measured by protractor and tape measure. A calibration with a larger sigma is refused."""

COARSE_SIGMA_RAD = np.deg2rad(1.0)
COARSE_SIGMA_M = 0.01
"""A parameter whose sigma is larger than this is reported."""

MOTION_NOISE_LEAST_SHARE = 0.2
"""Smallest assumed motion noise of fixture and joints (deflection and play that do not repeat at a pose), as a share of
the stated value. Poses do not determine it more precisely, and a stated value is hardly ever five times too large."""

STATED_VARIANCE_SHARE = 0.1
"""Share of a stated variance that is kept if the poses show a smaller variance: elsewhere in the workspace, the
variance may be larger than at these poses."""

STATED_VARIANCE_FACTOR = 1.5
"""The variance of new poses may be larger than stated by this factor: stated sizes of errors are known to 20 % at
best, and with hundreds of poses a test finds any difference significant."""

LEARNED_VARIANCE_FACTOR = 2.0
"""Variances estimated from other poses are known to within this factor."""

# Parameters

OFFSET_NOTICE_SIGMAS = 5.0
"""An offset farther from its nominal value than this many of its stated standard deviations is mentioned."""

FAR_FROM_NOMINAL_RAD = np.deg2rad(20.0)
FAR_FROM_NOMINAL_M = 0.06
"""Difference from the file's value that neither a mounting error nor an offset can credibly cause."""

LEAST_INFORMATION_SHARE = 0.5
"""A parameter counts as known from the files if the poses contribute a smaller share of its information."""

WELL_CONDITIONED = 100.0
"""If the scaled condition number at the readings is below this (the paper's limit), all directions are identifiable:
with an unidentifiable direction, noise of the readings does not lower the condition number to this value."""

# Poses

FEW_DOF = 30
"""With fewer degrees of freedom no test has power."""

REFUSED_DOF = 10
"""With fewer degrees of freedom, even the sigmas are wrong: with four poses, only 82 % of the 95 % intervals contained
the true value."""

FLIPPED_SHARE_REFUSED = 0.25
"""With a larger share of the poses on the other branch, it is unknown which branch is meant."""

OUTLIER_LARGEST_SHARE = 0.3
"""Largest share of the poses that can be outliers. If more poses deviate, single bad poses are not the cause."""

STEP_EDGE_POSES = 3
"""Smallest number of poses before and after a step. Fewer poses that deviate are outliers, which another test
reports."""

FROZEN_POSES = 4
"""At least this many consecutive readings that agree within noise while other joints move may mean a frozen sensor."""

OTHERS_MOVED_RAD = np.deg2rad(1.0)
"""Smallest change of the other joints' readings that counts as motion."""

IMMOBILE_RAD = np.deg2rad(1.0)
"""A joint counts as immobile if its readings in the whole pose set span less than this."""

MOST_CAUSES_FITTED = 4
"""Largest number of causes fitted one after the other; a pose set with more is not usable."""

MOST_CAUSES_REPORTED = 5
"""Largest number of causes reported together; a cause for which the calibration is refused is always reported."""

MOST_SOURCES_REPORTED = 3
"""Largest number of sources beyond their specification that are reported together."""

# Readings

RANGE_SLACK_RAD = np.deg2rad(1.0)
"""Uncertainty of an arm's stops. Readings may be outside their range by this plus `RANGE_SLACK_SIGMAS` sigmas."""

RANGE_SLACK_SIGMAS = 6.0
"""Number of the sensor's sigmas by which readings may be outside their range, in addition to `RANGE_SLACK_RAD`."""

FAR_OUT_OF_RANGE_SHARE = 0.1
"""A reading outside its range by more than this share of the range is not from this arm."""

SATURATED_SIGMAS = 3.0
SATURATED_POSES = 3
"""Readings count as saturated if at least this many are within `SATURATED_SIGMAS` of the same end of full scale."""

RADIANS_SPAN_RAD = np.deg2rad(5.0)
"""Readings may be in radians only if, taken as radians, they span more than this: otherwise the joint does not move."""

MOTION_SPREAD_SIGMAS = 6.0
MOTION_SPREAD_RAD = np.deg2rad(0.05)
"""A joint moved during sampling if the spread of a pose's samples exceeds both `MOTION_SPREAD_SIGMAS` and
`MOTION_SPREAD_RAD`. A smaller spread hardly affects the mean."""

SAME_READING_RAD = 1e-5
"""Two poses count as the same if no joint's reading differs by more: files have three decimal places of a degree."""

SAME_POINT_M = 1e-6
"""Measured points count as the same if no coordinate differs by more: files have three decimal places of a mm."""

# RVDTs

RVDT_LEAST_POSES = 15
RVDT_LEAST_SPAN = 0.15
"""A curve can be distinguished from a line only with at least RVDT_LEAST_POSES poses, whose readings cover at least the
share RVDT_LEAST_SPAN of full scale."""

RVDT_NOISE_RATIO = 1.25
"""Noise is out of specification if it certainly exceeds the specified noise by this factor. Smaller differences cannot
be detected, because readings are whole LSBs."""

RVDT_HARMFUL_RATIO = 3.0
"""Deviations (rms) of this many times the sensor's noise impair the calibration."""

NOISE_INTERVAL_RATIO = 4.0
"""Of a 95 % interval whose ends differ by more than this factor, only the upper end is reported."""

# Loops that do not close

NO_CLOSURE_M = 0.01
NO_CLOSURE_RAD = 0.03
"""Loops whose closure error (rms) is at least this large count as not closed at all."""

ALTERNATIVE_FIXTURE_POSES = 20
ALTERNATIVE_CLOSURE_M = 2e-3
"""At least `ALTERNATIVE_FIXTURE_POSES` poses count as closed in another fixture if their closure error (rms) is below
this, and if `ALTERNATIVE_CLOSURE_RATIO` is reached as well."""

ALTERNATIVE_CLOSURE_RATIO = 30.0
"""Smallest ratio of the closure error in the stated fixture to that in the other fixture (rms, 1 m : 1 rad)."""

STUCK_JOINT_TURN_RAD = np.deg2rad(3.0)
"""A joint with a constant reading has moved if its angles, as the loops determine them, differ by more than this; see
`STUCK_JOINT_CORRECTION_RAD`."""

STUCK_JOINT_CORRECTION_RAD = np.deg2rad(0.5)
"""The angles of a joint with a constant reading are known only if the loops close without this reading, and with
corrections of the other readings (rms) no larger than this."""

STUCK_JOINT_CORRECTION_RATIO = 4.0
"""A joint has turned without a change of its reading if the corrections that close the loop are smaller by this factor
with the joint free than with the joint at rest, and if `STUCK_JOINT_MOTION_SHARE` is reached as well."""

STUCK_JOINT_MOTION_SHARE = 0.1
"""Smallest corrections that close the loop with the joint at rest, as a share of the change of the readings. Smaller
ones may be due to an inexact placement, above all with a ball, whose loop hardly overdetermines a joint's rotation."""

STEP_RESIDUAL_SHARE = 0.25
"""A joint's reading has a step if a fitted step leaves at most this share of the sum of squares that a smooth curve
leaves."""
