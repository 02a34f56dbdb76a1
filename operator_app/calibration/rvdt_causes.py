"""RVDTs that the loop itself finds out of specification, as causes of a verdict. Weighs nothing; knows no screen."""

from __future__ import annotations

from operator_app.calibration.causes import NamedCause
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Rvdt
from solver.diagnostics.fault_candidate import LinearityDeviation
from solver.diagnostics.rvdt import RvdtVerdict, Soundness, linearity_deviation


def measured_deviations(
    verdicts: tuple[RvdtVerdict, ...], arm: ArmModel
) -> dict[int, LinearityDeviation]:
    """How far RVDTs stray from their best lines, by joint, where the loop could measure it."""
    return {
        v.joint: linearity_deviation(v.figures, sensor)
        for v in verdicts
        if v.figures is not None and isinstance(sensor := arm.joints[v.joint - 1].sensor, Rvdt)
    }


def rvdt_causes(verdicts: tuple[RvdtVerdict, ...], arm: ArmModel) -> tuple[NamedCause, ...]:
    """RVDTs out of specification where nothing else is wrong: the sigmas count their curves in."""
    return tuple(
        NamedCause(
            code=f"RVDT_{v.joint}",
            probability=1.0,
            text=v.text,
            remedy=f"{_remedy_of(v, arm)}, or calibrate with --unsensed {v.joint}",
            refuses=False,
        )
        for v in verdicts
        if v.verdict is Soundness.OUT_OF_SPECIFICATION
    )


def _remedy_of(verdict: RvdtVerdict, arm: ArmModel) -> str:
    """What to do about an RVDT out of specification: its text says what to do about noise."""
    deviation = measured_deviations((verdict,), arm).get(verdict.joint)
    sensor = arm.joints[verdict.joint - 1].sensor
    if (
        deviation is not None
        and isinstance(sensor, Rvdt)
        and deviation.beyond(sensor.linearity_rad)
    ):
        return "have it replaced or linearised"
    if verdict.noise is not None and verdict.noise.from_spread:
        return f"see whether the spread of its readings is as recorded (sd{verdict.joint}_deg)"
    return "look for what disturbs it"
