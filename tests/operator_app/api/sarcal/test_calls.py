"""Invalid calls: errors that name the argument, its value and what to give."""

import re
from contextlib import nullcontext
from pathlib import Path
from threading import Event, Thread
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
import sarcal
from sarcal.calls import one_blas_thread
from threadpoolctl import threadpool_info, threadpool_limits

POSES = Path(__file__).parents[3] / "data/hinge/hinge_exact.csv"
HINGE: Any = {"arm": "sarcos_dextrous", "fixture": "hinge"}
Q = np.zeros((12, 7))


def calibrate(**changes):
    return sarcal.calibrate(**{**HINGE, "poses": POSES, **changes})


def with_nan(value):
    q = Q.copy()
    q[3, 2] = value
    return q


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda: sarcal.simulate(**HINGE, poses=0), ValueError),
        (lambda: sarcal.simulate(**HINGE, poses=10.5), TypeError),
        (lambda: sarcal.simulate(**HINGE, samples=0), ValueError),
        (lambda: sarcal.simulate(**HINGE, seed=-1), ValueError),
        (lambda: sarcal.plan(**HINGE, poses=0), ValueError),
        (lambda: sarcal.plan(**HINGE, poses=True), TypeError),
        (lambda: sarcal.plan(**HINGE, drive_joints=[0, 5]), ValueError),
        (lambda: sarcal.plan(**HINGE, unsensed_joints=6), TypeError),
        (lambda: calibrate(unsensed_joints="6,7"), TypeError),
        (lambda: calibrate(unsensed_joints=[6.5]), TypeError),
        (lambda: calibrate(unsensed_joints=[8]), ValueError),
        (lambda: calibrate(length_tolerance_mm=-1), ValueError),
        (lambda: calibrate(length_tolerance_mm=float("nan")), ValueError),
        (lambda: calibrate(length_tolerance_mm="1"), TypeError),
        (lambda: calibrate(estimator="best"), ValueError),
        (lambda: calibrate(poses=sarcal.poses_of(q_rad=Q[:, :6])), ValueError),
        (lambda: calibrate(poses=sarcal.poses_of(q_rad=Q.T)), ValueError),
        (lambda: calibrate(poses=7), TypeError),
        (lambda: calibrate(poses=Q), TypeError),
        (lambda: calibrate(arm=3), TypeError),
        (lambda: calibrate(fixture=sarcal.load_arm("franka_panda")), TypeError),
        (lambda: sarcal.load_arm(b"franka_panda"), TypeError),
        (lambda: sarcal.poses_of(q_rad=Q[:0]), ValueError),
        (lambda: sarcal.poses_of(q_deg=Q + 1j), TypeError),
        (lambda: sarcal.poses_of(q_rad=with_nan(np.inf)), ValueError),
        (lambda: sarcal.poses_of(q_rad=[[1.0, 2.0], [3.0]]), ValueError),
        (lambda: sarcal.poses_of(q_rad=[["a", "b"]]), TypeError),
        (lambda: sarcal.poses_of(q_rad=Q, names="left"), TypeError),
        (lambda: sarcal.poses_of(q_rad=Q, samples=[1, 2]), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q, samples=2.5), TypeError),
        (lambda: sarcal.poses_of(q_rad=Q, sd_rad=[0.1, 0.2]), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q, endpoint_m=Q[:, :2]), ValueError),
        (lambda: sarcal.verify("sessions/mine", POSES), TypeError),
        (lambda: sarcal.compare(3, "b.yaml"), TypeError),
        (lambda: sarcal.compare("a.yaml", "b.yaml", level=2), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q, placement=10**30), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q, samples=10**30), ValueError),
        (lambda: sarcal.load_arm("sarcos"), sarcal.ConfigError),
        (sarcal.poses_of, ValueError),
        (lambda: sarcal.poses_of(q_deg=np.ma.masked_equal(Q, 0.0)), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q, names=["left"]), ValueError),
        (lambda: calibrate(unsensed_joints=[True]), TypeError),
        (lambda: sarcal.load_arm("ur5e").fk(None), TypeError),
        (lambda: sarcal.load_poses(POSES, joint_count="7"), TypeError),
        (lambda: sarcal.poses_of(q_rad=Q, endpoint_m=Q[:, :3] + 870.0), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q, endpoint_m=Q[:, :6] + 2.0), ValueError),
        (lambda: sarcal.poses_of(q_rad=Q).to_csv("/no/such/folder/poses.csv"), sarcal.WriteError),
        (lambda: calibrate().save(""), ValueError),
    ],
)  # fmt: skip
def test_invalid_argument_is_named(call, kind, approve):
    with pytest.raises(kind) as error:
        call()
    approve(str(error.value))


def test_types_admit_the_arrays_that_the_functions_take():
    for function, name in (
        (sarcal.poses_of, "placement"), (sarcal.poses_of, "samples"),
        (sarcal.calibrate, "unsensed_joints"), (sarcal.plan, "drive_joints"),
    ):  # fmt: skip
        hint = get_type_hints(function.__wrapped__ if name.endswith("joints") else function)[name]
        assert get_origin(np.typing.NDArray[np.int64]) in {
            get_origin(part) for part in get_args(hint)
        }
    assert sarcal.poses_of(q_rad=Q, placement=np.ones(12, dtype=int)).placement.sum() == 12


def test_fk_refuses_invalid_readings_and_frames(result):
    q = result.poses.q_rad
    for frame in ("Tip", "base", ""):
        with pytest.raises(ValueError, match=f"frame='{frame}': give 'tip' or 'flange'"):
            result.fk(q, frame=frame)
    for wrong, kind, message in (
        (q[:, :3], ValueError, "q_rad has shape (60, 3): the arm has 7 joints"),
        (0.1, ValueError, "q_rad has shape ()"),
        (with_nan(np.nan), ValueError, "q_rad contains nan at index [3, 2]"),
        (q + 0j, TypeError, "q_rad: give real numbers, not complex numbers"),
        (result.poses.q_deg, ValueError, "convert degrees to radians with np.deg2rad"),
    ):
        for method in (result.fk, result.tip_sigma):
            with pytest.raises(kind, match=re.escape(message)):
                method(wrong)
    # Readings beyond a turn and lists are accepted.
    assert result.fk((q[0] + 2.0 * np.pi).tolist()).shape == (4, 4)


def test_scalars_are_broadcast_to_all_poses(tmp_path):
    def file(poses):
        return poses.to_csv(tmp_path / "poses.csv").read_bytes()

    scalars = sarcal.poses_of(q_rad=Q, samples=32, sd_rad=0.1, placement=2)
    arrays = sarcal.poses_of(
        q_rad=Q, samples=[32] * 12, sd_rad=np.full((12, 7), 0.1), placement=[2] * 12
    )
    assert file(scalars) == file(arrays)
    by_joint = sarcal.poses_of(q_rad=Q, sd_rad=np.arange(7.0))
    assert file(by_joint) == file(sarcal.poses_of(q_rad=Q, sd_rad=np.tile(np.arange(7.0), (12, 1))))
    assert file(by_joint) != file(sarcal.poses_of(q_rad=Q, sd_rad=np.zeros((12, 7))))


def test_unused_endpoints_are_reported(result, tmp_path, run_command):
    q = result.poses.q_rad
    measured = sarcal.poses_of(q_rad=q, endpoint_m=np.zeros((len(q), 3)))
    message = "measured endpoints (x_m,y_m,z_m), which a hinge fixture does not use"
    assert any(message in text for text in calibrate(poses=measured).warnings)
    assert not any(message in text for text in result.warnings)
    assert message in run_command(0, "solve", measured.to_csv(tmp_path / "measured.csv")).words


def test_incomparable_calibrations_raise_our_error(result, tmp_path):
    ours = result.export(tmp_path / "ours.yaml")
    other = tmp_path / "other.yaml"
    other.write_text(ours.read_text().replace("sarcos_dextrous", "another"))
    with pytest.raises(
        sarcal.IncomparableError, match="A is from a sarcos_dextrous, B from a another"
    ):
        sarcal.compare(ours, other)
    assert issubclass(sarcal.IncomparableError, sarcal.SessionError)
    with pytest.raises(sarcal.SessionError):
        sarcal.compare(ours, tmp_path / "nothing")


def test_export_into_missing_or_same_file_is_refused(result, tmp_path):
    own = tmp_path / "own.urdf"
    with pytest.raises(sarcal.ConfigError, match=r"own\.urdf: there is no such file"):
        result.export(tmp_path / "out.urdf", into=own)
    result.export(own)
    before = own.read_bytes()
    with pytest.raises(ValueError, match="is also the file of into="):
        result.export(own, into=own)
    assert own.read_bytes() == before


def blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.mark.parametrize("raises", [False, True])
def test_blas_threads_are_limited_and_restored(raises):
    threads_inside = []

    @one_blas_thread
    def compute():
        threads_inside.append(blas_threads())
        if raises:
            raise ValueError

    with threadpool_limits(limits=2, user_api="blas"):
        assert blas_threads() == {2}
        try:
            compute()
        except ValueError:
            assert raises
        assert blas_threads() == {2}
    assert threads_inside == [{1}]


def test_of_calls_that_overlap_only_one_limits_blas_threads(monkeypatch):
    """The second one would restore the limit of the first, after that has ended."""
    made, second_ran = list[int](), Event()
    monkeypatch.setattr("threadpoolctl.threadpool_limits", lambda **_: nullcontext(made.append(1)))
    second = Thread(target=one_blas_thread(second_ran.set))
    one_blas_thread(lambda: (second.start(), second_ran.wait(9.0), second.join()))()
    assert made == [1]


def test_computing_functions_limit_blas_threads():
    for name in ("calibrate", "compare", "load_result", "plan", "simulate", "verify"):
        assert hasattr(getattr(sarcal, name), "__wrapped__"), name


def test_a_plan_without_a_reading_has_no_sigma_of_its_offset():
    planned = sarcal.plan(**HINGE, poses=4, drive_joints=[1, 5], unsensed_joints=[7])
    assert "theta_off_7_deg" not in planned.sigmas
    assert planned.sigmas["theta_off_6_deg"] > 0.0
    assert len(planned.sigmas) == 13
