"""Kernel CAN under User-Mode Linux or in an emulated PC: the transport contract, and can-utils as peers."""

import os
import re
import shlex
import sys

import pytest

from tests.oracles.guest_linux import in_emulated_linux, in_user_mode_linux

pytestmark = pytest.mark.needs("candump", "ip")

INSIDE = """
import pathlib, subprocess, sys, time
import can
from hardware.buses.python_can import BusSettings, open_bus
from hardware.errors import BusError

bus = open_bus(BusSettings(interface="socketcan", channel="vcan0"))
dump = subprocess.Popen(
    ["candump", "-n", "2", "-L", "vcan0,181:7FF"], stdout=subprocess.PIPE, text=True
)
deadline = time.monotonic() + 20  # candump is ready when the kernel lists a receiver for 181h
while " 181 " not in pathlib.Path("/proc/net/can/rcvlist_fil").read_text():
    if time.monotonic() > deadline:
        sys.exit("candump did not start")
bus.send(can.Message(arbitration_id=0x181, data=b"\\x11\\x22\\x33", is_extended_id=False))
bus.send(can.Message(arbitration_id=0x181, data=b"\\xff", is_extended_id=False))
print("DUMP", [line.split()[-1] for line in dump.communicate(timeout=20)[0].splitlines()])
subprocess.run(["cansend", "vcan0", "581#4B41600027020000"], check=True)
received = bus.recv(10)
print("RECEIVED", hex(received.arbitration_id), received.data.hex())
other = open_bus(BusSettings(interface="socketcan", channel="vcan0"))
for _ in range(3000):  # two seconds of an arm's traffic, not read by a suspended program
    other.send(can.Message(arbitration_id=0x181, is_extended_id=False))
other.shutdown()
print("BUFFERED", sum(bus.recv(0) is not None for _ in range(4000)))
try:
    open_bus(BusSettings(interface="socketcan", channel="vcan7"))
except BusError as error:
    print("MISSING", error)
subprocess.run(["ip", "link", "set", "vcan0", "down"], check=True)
try:
    open_bus(BusSettings(interface="socketcan", channel="vcan0"))
except BusError as error:
    print("DOWN", error)
bus.shutdown()
"""


PYTEST = [
    sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", "--basetemp=/run/pytest",
    "--color=no",
]  # fmt: skip


@pytest.mark.campaign
@pytest.mark.needs("linux.uml")
def test_socketcan_meets_transport_and_arm_contracts():
    # Timing under a user-mode kernel on one processor is not representative; two sessions are enough.
    chosen = "socketcan and (transport_contract or two_driven or stop_in_a_move)"
    contracts = [
        "tests/contracts/test_transport_contract.py",
        "tests/contracts/arm/test_contract.py",
    ]
    output = in_user_mode_linux(*PYTEST, "--no-cov", "-n0", "-k", chosen, *contracts)
    assert "skipped" not in output
    assert " passed" in output


@pytest.mark.campaign
@pytest.mark.needs("linux.uml")
def test_socketcan_agrees_with_can_utils():
    check_can_utils_output(in_user_mode_linux(sys.executable, "-c", INSIDE))


EMULATED = pytest.mark.needs("qemu-system-x86_64", "busybox")


@pytest.mark.campaign
@pytest.mark.parametrize(
    "run",
    [
        pytest.param(in_user_mode_linux, marks=pytest.mark.needs("linux.uml")),
        pytest.param(in_emulated_linux, marks=EMULATED),
    ],
)
def test_frame_refused_by_full_queue_is_sent_again_once(run):
    kernel = f"QEMU_KERNEL_ROOT={os.environ.get('QEMU_KERNEL_ROOT', '')}"
    output = run("env", kernel, sys.executable, "-m", "tests.oracles.full_transmit_queue")
    results = {
        line.split()[0]: line.partition(" ")[2] for line in output.splitlines() if line.strip()
    }
    assert results["FULL"] == "105"  # ENOBUFS
    assert "transmit queue was full for 10 ms" in results["ENDS"]
    assert "sudo ip link set can0 txqueuelen 1000" in results["ENDS"]
    sent, retries = re.fullmatch(r"(\d+) AGAIN (\d+)", results["TAKEN"]).groups()  # type: ignore[union-attr]
    assert int(sent) == 2000
    assert int(retries) > 0


@pytest.mark.campaign
@pytest.mark.needs("qemu-system-x86_64", "busybox")
def test_socketcan_meets_transport_contract_in_emulated_pc():
    # One boot for both, with only the plugins that the project's settings name: an import takes a second.
    both = shlex.join([sys.executable, "-c", INSIDE]) + " && ip link set vcan0 up && " + shlex.join([
        "env", "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1", *PYTEST, "-p", "pytest_timeout", "-p", "pytest_asyncio.plugin",
        "-o", "addopts=--import-mode=importlib --strict-markers", "-k", "socketcan",
        "tests/contracts/test_transport_contract.py",
    ])  # fmt: skip
    output = in_emulated_linux("/bin/sh", "-c", both)
    check_can_utils_output(output)
    assert "skipped" not in output
    assert int(re.search(r"(\d+) passed", output)[1]) >= 24  # type: ignore[index]


def check_can_utils_output(output: str) -> None:
    lines = output.splitlines()
    assert "DUMP ['181#112233', '181#FF']" in lines
    assert "RECEIVED 0x581 4b41600027020000" in lines
    assert "BUFFERED 3000" in lines
    (missing,) = (line for line in lines if line.startswith("MISSING"))
    assert "no CAN device vcan7" in missing
    assert "ip link add vcan7 type vcan" in missing
    (down,) = (line for line in lines if line.startswith("DOWN"))
    assert "vcan0 is down" in down
    assert "ip link set vcan0 up" in down
