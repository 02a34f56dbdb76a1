"""Whoever keeps the time of an arm runs before others, as far as the system allows it."""

from __future__ import annotations

import os
import threading

import pytest

from hardware.timing import (
    LOOP_PRIORITY,
    PRIORITY,
    raise_loop_priority,
    real_time_priority,
)


def policy_of_a_thread() -> int:
    found: list[int] = []
    thread = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0)))
    thread.start()
    thread.join()
    return found[0]


def priority_of_a_loop() -> int:
    found: list[int] = []

    def loop() -> None:
        raise_loop_priority()
        found.append(os.sched_getparam(0).sched_priority)

    thread = threading.Thread(target=loop)
    thread.start()
    thread.join()
    return found[0]


def allowed() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


@pytest.mark.skipif(not allowed(), reason="this user may not ask for real-time priority")
def test_threads_started_inside_run_in_real_time_and_none_afterwards() -> None:
    with real_time_priority():
        assert policy_of_a_thread() == os.SCHED_RR
    assert policy_of_a_thread() == os.sched_getscheduler(0) == os.SCHED_OTHER


def test_where_it_is_not_allowed_everything_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time_priority():
        assert policy_of_a_thread() == os.SCHED_OTHER


@pytest.mark.skipif(not allowed(), reason="this user may not ask for real-time priority")
def test_a_loop_runs_before_the_rest_of_a_program_in_real_time_only() -> None:
    with real_time_priority():
        assert priority_of_a_loop() == LOOP_PRIORITY > PRIORITY
        assert os.sched_getparam(0).sched_priority == PRIORITY
    assert priority_of_a_loop() == 0
