# ruff: noqa: T201 - a benchmark prints
"""What the operator's side of the bus costs. Run: python -m tests.benchmarks.operator_bus virtual|loopback

`virtual` has the controller in this process, `loopback` in one of its own. Printed: SYNC to the seventh
TPDO1, everything in per SYNC of a move and of a reading, a parameter upload of 4 kB with its reading
back, and STOP in the middle of a move, to the seventh quick stop as an observer sees it on the bus.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.synchronize import Event

import numpy as np

from hardware.arm import ArmSnapshot
from hardware.buses.python_can import BusSettings, open_bus
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import Stopped
from hardware.timing import Pace
from tests.contracts.arm.bench import TWO_DRIVEN, controller_on, operator_on

DOCUMENT = b"11 -22 33 -44 55 -6 7".ljust(4000)


def serve(interface: str, channel: str, ready: Event, done: Event) -> None:
    """Run the controller until told to stop."""
    with controller_on(BusSettings(interface=interface, channel=channel)):
        ready.set()
        done.wait()


@contextmanager
def controller_elsewhere(settings: BusSettings) -> Iterator[None]:
    """Run the controller in a process of its own."""
    spawn = get_context("spawn")
    ready, done = spawn.Event(), spawn.Event()
    process = spawn.Process(target=serve, args=(settings.interface, settings.channel, ready, done))
    process.start()
    ready.wait(60)
    try:
        yield
    finally:
        done.set()
        process.join()


def sync_to_answers_us(settings: BusSettings, arm: CanopenArm, samples: int) -> list[float]:
    """Times from each SYNC to the seventh TPDO1, as an observer receives them.

    `samples` have to fit into its receive buffer. On a fast bus it may receive the next SYNC before the
    last answer; those are left out.
    """
    times: list[float] = []
    began, answers, syncs = 0.0, 0, 0
    with open_bus(settings) as observer:
        arm.capture(samples)
        while syncs < samples or answers < 7:
            message = observer.recv(1.0)
            if message is None:
                raise RuntimeError(f"{samples} SYNCs were answered, fewer were seen")
            if message.arbitration_id == 0x080:
                began, answers, syncs = message.timestamp, 0, syncs + 1
            elif 0x181 <= message.arbitration_id <= 0x187:
                answers += 1
                if answers == 7:
                    times.append((message.timestamp - began) * 1e6)
    return times


def stop_ms(settings: BusSettings, arm: CanopenArm) -> tuple[float, float]:
    """Duration of `stop`, and time to the seventh quick stop frame, in the middle of a move."""
    start = arm.snapshot().positions_rad[1]
    moving = threading.Event()

    def watch(snapshot: ArmSnapshot) -> str | None:
        if snapshot.positions_rad[1] < start - 0.02:
            moving.set()
        return None

    def move() -> None:
        try:
            arm.move({2: start - 0.5}, speed_rad_per_s=0.05, watch=watch)
        except Stopped:
            return

    with open_bus(settings) as observer:
        mover = threading.Thread(target=move)
        mover.start()
        moving.wait(30)
        began, before = time.time(), time.perf_counter()
        arm.stop()
        took = time.perf_counter() - before
        mover.join()
        seen: dict[int, float] = {}
        while len(seen) < 7:
            message = observer.recv(1.0)
            if message is None:
                raise RuntimeError("seven quick stops were sent, fewer were seen")
            if 0x201 <= message.arbitration_id <= 0x207 and message.data[0] == 0x02:
                seen.setdefault(message.arbitration_id, message.timestamp - began)
    return took * 1e3, max(seen.values()) * 1e3


def measure(settings: BusSettings, pace: Pace) -> None:
    """Run all measurements and print them."""
    arm = operator_on(settings, pace)
    arm.connect()
    try:
        arm.take_control()
        arm.set_modes(TWO_DRIVEN)
        times = np.array([us for _ in range(5) for us in sync_to_answers_us(settings, arm, 400)])
        median, late = np.median(times), np.percentile(times, 99)
        print(f"SYNC to 7 TPDO1     median {median:.0f} us, p99 {late:.0f} us ({len(times)})")
        start = arm.snapshot().positions_rad
        began = time.perf_counter()
        moved = arm.move({2: start[1] + 0.2, 5: start[4] - 0.2}, speed_rad_per_s=0.2)
        print(
            f"move, all in        {(time.perf_counter() - began) / moved.syncs * 1e3:.3f} ms a SYNC"
        )
        began = time.perf_counter()
        arm.capture(1000)
        print(f"reading, all in     {time.perf_counter() - began:.3f} ms a SYNC")
        uploads = []
        for _ in range(5):
            began = time.perf_counter()
            arm.upload_parameters(DOCUMENT)
            uploads.append((time.perf_counter() - began) * 1e3)
        print(f"upload of 4 kB      {statistics.median(uploads):.0f} ms with reading back")
        stops = []
        for _ in range(5):
            stops.append(stop_ms(settings, arm))
            arm.reset_stop()
            arm.take_control()
            arm.set_modes(TWO_DRIVEN)
        print(
            f"STOP                call {max(s[0] for s in stops):.2f} ms, seventh quick stop on the"
        )
        print(
            f"                    bus after {max(s[1] for s in stops):.2f} ms (largest of {len(stops)})"
        )
    finally:
        arm.close()


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("interface", choices=["virtual", "loopback"])
    parser.add_argument("--real-time", action="store_true", help="100 SYNCs a second")
    args = parser.parse_args()
    settings = BusSettings(interface=args.interface, channel="benchmark")
    pace = Pace.REAL_TIME if args.real_time else Pace.FAST_FORWARD
    where = controller_on if args.interface == "virtual" else controller_elsewhere
    with where(settings):
        measure(settings, pace)


if __name__ == "__main__":
    sys.exit(main())
