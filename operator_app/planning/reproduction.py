"""Reproduction of the paper's experiment (Giugovaz and Hollerbach, sections 3 and 4) on a simulated specimen.

The original readings are not available: the specimen has the three suspected sources of error, with magnitudes that
give the reported residuals. The results are similar to the published ones, but not from the same arm.
"""

from dataclasses import dataclass, replace

import numpy as np

from hardware.arm import JointMode
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.virtual.axis import JointCommand
from hardware.virtual.scenarios import STIFF, Scenario, scenario
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.result import Solution
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.planning.exploration import box_of, waypoints
from solver.arrays import FloatArray
from solver.chain.parameters import DhEntry, wrap_angle
from solver.chain.poses import PoseSet

PUBLISHED_POSES = 40
SIGMA_POS_M, SIGMA_ORI_RAD, PUBLISHED_CONDITION = 2.7e-3, 6.6e-3, 28.0
"""Values published in the paper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Closure errors, rms by eqs. 14 and 15, caused by one source of error or by all sources together."""

    source: str
    position_m: float
    orientation_rad: float
    condition: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """Result of one remedy: rms deviation of the calibrated offsets (rad) and lengths (m) from the true values."""

    name: str
    paragraph: str
    offsets_rad: float
    lengths_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Published:
    """The reproduced results.

    `solution`: result of the paper's estimator, with all sources of error. `printed`: values (rad, m) in table 2 of the
    paper, by parameter. `shares`, `remedies`: sources of error and remedies in the order of section 4.
    """

    solution: Solution
    printed: dict[str, float]
    shares: tuple[Share, ...]
    remedies: tuple[Remedy, ...]
    poses: int

    @property
    def farthest_sigmas(self) -> float:
        """Largest deviation of a parameter from its value in table 2 of the paper, in standard deviations."""
        e = self.solution.estimate
        printed = np.array([self.printed[p.name] for p in e.parameters])
        return float(np.max(np.abs(e.x - printed) / e.standard_deviation))


def published(*, poses: int = PUBLISHED_POSES) -> Published:
    """Reproduce the experiment of section 3 of the paper and the analysis of section 4."""
    procedure = load_procedure("hinge")
    all_three = scenario("as_reported")
    noise_only = replace(all_three, linearity_of_full_scale=0.0, lengths=None, loads=STIFF)
    poses_taken = capture_specimen(procedure, all_three, poses=poses)
    solution = _calibrated(procedure, poses_taken)
    # The specimen's true values, without its length errors, are those of table 2 of the paper.
    table2 = all_three.truth.table.stacked()
    entries = {p.name: DhEntry.parse(p.name) for p in solution.estimate.parameters}
    printed = {name: float(table2[entry.kind, entry.row]) for name, entry in entries.items()}
    linearity = all_three.linearity_of_full_scale
    alone = (
        ("RVDT curves of the wrist", replace(noise_only, linearity_of_full_scale=linearity)),
        ("fixed lengths off by 1 to 2 mm", replace(noise_only, lengths=all_three.lengths)),
        ("fixture that yields", replace(noise_only, loads=all_three.loads)),
        ("noise and counts", noise_only),
    )
    shares = [
        _share(name, _calibrated(procedure, capture_specimen(procedure, chosen, poses=poses)))
        for name, chosen in alone
    ]
    shares.append(_share("all together", solution))
    # The true fixed lengths of the specimen, as if measured by an open-loop calibration.
    arm, true = procedure.arm, all_three.true_loop().table
    measured = replace(arm, table=replace(arm.table, s_m=true.s_m[1:], a_m=true.a_m[1:]))
    stiff = capture_specimen(procedure, replace(all_three, loads=STIFF), poses=poses)
    known = replace(procedure, arm=measured)
    unsensed = _calibrated(procedure, poses_taken, "implicit", (6, 7))
    remedies = (
        ("as it is, the paper's estimator", "3", solution),
        ("as it is, implicit", "", _calibrated(procedure, poses_taken, "implicit")),
        ("joints 6 and 7 unsensed", "4, first", unsensed),
        ("fixed lengths measured", "4, second", _calibrated(known, poses_taken)),
        ("a rigid fixture", "4, third", _calibrated(procedure, stiff)),
        ("all three", "4", _calibrated(known, stiff, "implicit", (6, 7))),
    )
    return Published(
        solution=solution,
        printed=printed,
        shares=tuple(shares),
        remedies=tuple(_remedy(name, where, variant, printed) for name, where, variant in remedies),
        poses=poses,
    )


def _calibrated(
    procedure: Procedure,
    poses: PoseSet,
    estimator: str = "paper",
    unsensed_joints: tuple[int, ...] = (),
) -> Solution:
    return calibrate(
        procedure.arm,
        procedure.fixture.fixture,
        poses,
        estimator=estimator,
        unsensed_joints=unsensed_joints,
    )


def _share(name: str, solution: Solution) -> Share:
    sigmas = solution.estimate.sigmas
    turned = sigmas.orientation_rad
    return Share(
        source=name,
        position_m=sigmas.position_m.rms,
        orientation_rad=float("nan") if turned is None else turned.rms,
        condition=solution.identifiability.scaled_condition_number,
    )


def _remedy(name: str, where: str, solution: Solution, truth: dict[str, float]) -> Remedy:
    estimate = solution.identified
    errors = {
        p.name: float(x) - truth[p.name]
        for p, x in zip(estimate.parameters, estimate.x, strict=True)
        if p.name in truth
    }
    turned = [wrap_angle(e) for n, e in errors.items() if n.startswith("theta_off")]
    lengths = [e for n, e in errors.items() if n.startswith(("a_", "s_"))]
    return Remedy(
        name=name,
        paragraph=where,
        offsets_rad=float(np.sqrt(np.mean(np.square(turned)))),
        lengths_m=float(np.sqrt(np.mean(np.square(lengths)))),
    )


AT_REST = 40
"""Control periods after a move: more than the quasi-static chain needs to come to rest."""


def capture_specimen(procedure: Procedure, chosen: Scenario, *, poses: int) -> PoseSet:
    """Simulate the capture of `poses` poses in scenario `chosen` at the waypoints of `procedure`, without a CAN bus."""
    arm, plan = procedure.arm, procedure.capture
    plant = chosen.build(arm)
    resolution_rad = [sensor.resolution_rad for sensor in plant.sensors]
    drives = procedure.position_joints or ()
    joints = range(1, arm.joint_count + 1)
    modes = [JointMode.POSITION if j in drives else JointMode.FREE for j in joints]

    def step(targets_rad: FloatArray) -> FloatArray:
        commands = list(zip(modes, targets_rad.tolist(), strict=True))
        return np.multiply(plant.step(commands).position_counts, resolution_rad)

    held: list[JointCommand] = [(None, 0.0)] * arm.joint_count
    q = np.multiply(plant.step(held).position_counts, resolution_rad)
    box = box_of(arm, plan, drives, home_rad=arm.home_rad, start_rad=q)
    targets, readings, spreads = q.copy(), [], []
    for waypoint in waypoints(box, poses=plan.poses, seed=plan.seed)[:poses]:
        goal = targets.copy()
        for joint, angle in waypoint.items():
            goal[joint - 1] = angle
        farthest = float(np.abs(goal - targets).max())
        steps = max(1, round(farthest / (plan.speed_rad_per_s * CONTROL_PERIOD_S)))
        for share in np.linspace(0.0, 1.0, steps + 1)[1:].tolist():
            step(targets + share * (goal - targets))
        targets = goal
        for _ in range(AT_REST):
            step(targets)
        samples = np.array([step(targets) for _ in range(plan.samples_per_pose)])
        readings.append(samples.mean(axis=0))
        spreads.append(samples.std(axis=0, ddof=1))
    return PoseSet(
        placement=np.ones(poses, dtype=np.int64),
        label=tuple(str(k) for k in range(1, poses + 1)),
        q_rad=np.array(readings),
        sd_rad=np.array(spreads),
        samples=np.full(poses, plan.samples_per_pose, dtype=np.int64),
    )
