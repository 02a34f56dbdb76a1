"""Combines the files of `sarcal check` into arms in fixtures, and predicts whether these arms can be calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from operator_app.calibration.experiment import Experiment
from operator_app.config.any_file import FilesRead
from operator_app.config.fixture_file import FixtureSpec
from operator_app.config.poses_file import LoadedPoses
from operator_app.config.procedure import Procedure
from operator_app.planning.feasibility import (
    Feasibility,
    assess_feasibility,
    identifiability_of_poses,
)
from operator_app.planning.proposals import closing_home
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.diagnostics.identifiability import Identifiability
from solver.errors import SolverError


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """An arm in a fixture.

    `procedure`: name of the procedure; empty without one. `held`: entries fixed at their value in the arm file, with
    the reason. `home`: proposed home (n,), rad, with its `Feasibility`; None if the arm's own home is good, or no home
    was found. `poses`: names of the poses files for this arm and fixture, each with the identifiability from its poses.
    `unfit`: names of the poses files that do not fit this fixture, each with the reason.
    """

    arm: ArmModel
    fixture: FixtureSpec
    feasibility: Feasibility
    procedure: str
    held: Mapping[str, str]
    home: tuple[FloatArray, Feasibility] | None
    poses: tuple[tuple[str, Identifiability], ...]
    unfit: tuple[tuple[str, str], ...]

    @property
    def refused(self) -> bool:
        """Whether a calibration with these files would fail."""
        unidentifiable = any(identified.directions for _, identified in self.poses)
        return self.feasibility.refused or unidentifiable or bool(self.unfit)


def chains_of(files: FilesRead) -> tuple[Chain, ...]:
    """Return the chain of each procedure or, without procedures, of every arm with every fixture."""
    procedures = [p.holds for p in files.of("procedure") if isinstance(p.holds, Procedure)]
    if procedures:
        return tuple(_chain(files, p.arm, p.fixture, p) for p in procedures)
    arms = [f.holds for f in files.of("arm") if isinstance(f.holds, ArmModel)]
    fixtures = [f.holds for f in files.of("fixture") if isinstance(f.holds, FixtureSpec)]
    return tuple(_chain(files, arm, fixture) for arm in arms for fixture in fixtures)


def _chain(
    files: FilesRead, arm: ArmModel, spec: FixtureSpec, procedure: Procedure | None = None
) -> Chain:
    drives = None if procedure is None else procedure.position_joints
    unsensed = () if procedure is None else procedure.unsensed_joints
    identified: list[tuple[str, Identifiability]] = []
    unfit: list[tuple[str, str]] = []
    for looked in files.of("poses"):
        file, loaded = looked.source.file, looked.holds
        if not isinstance(loaded, LoadedPoses) or loaded.poses.q_rad.shape[1] != arm.joint_count:
            continue
        experiment = Experiment(
            arm=arm, fixture=spec.fixture, poses=loaded.poses, unsensed=unsensed
        )
        try:
            identified.append((file, identifiability_of_poses(experiment)))
        except (SolverError, ValueError) as error:
            unfit.append((file, str(error)))
    prospect = assess_feasibility(
        arm, spec.fixture, position_joints=drives, unsensed_joints=unsensed
    )
    return Chain(
        arm=arm,
        fixture=spec,
        feasibility=prospect,
        home=closing_home(arm, spec.fixture, prospect),
        procedure="" if procedure is None else procedure.name,
        held={} if procedure is None else procedure.held,
        poses=tuple(identified),
        unfit=tuple(unfit),
    )
