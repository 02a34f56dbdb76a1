import pytest
import sarcal
from sarcal.blas_threads import one_blas_thread
from threadpoolctl import threadpool_info, threadpool_limits


def blas_threads() -> set[int]:
    return {found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"}


@pytest.mark.parametrize("fails", [False, True])
def test_one_thread_inside_and_the_callers_setting_afterwards(fails: bool) -> None:
    inside = []

    @one_blas_thread
    def computed() -> None:
        inside.append(blas_threads())
        if fails:
            raise ValueError

    with threadpool_limits(limits=2, user_api="blas"):
        assert blas_threads() == {2}
        try:
            computed()
        except ValueError:
            assert fails
        assert blas_threads() == {2}
    assert inside == [{1}]


@pytest.mark.parametrize(
    "name", ["calibrate", "compare", "load_result", "plan", "simulate", "verify"]
)
def test_whatever_computes_is_limited(name: str) -> None:
    assert hasattr(getattr(sarcal, name), "__wrapped__")
