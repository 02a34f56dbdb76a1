"""Kernel CAN under User-Mode Linux: the contracts of transport and arm, and can-utils as peers."""

import re
import shlex
import sys

import pytest

from tests.oracles.guest_linux import in_user_mode_linux

pytestmark = [pytest.mark.needs("linux.uml", "candump", "ip"), pytest.mark.campaign]


def test_socketcan_meets_arm_contract():
    # Timing under a user-mode kernel on one processor is not representative; two sessions are enough.
    chosen = "socketcan and (two_driven or stop_in_a_move)"
    command = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-cov", "-n0", "-k", chosen]
    output = in_user_mode_linux(
        sys.executable, *command, "--basetemp=/run/pytest", "tests/contracts/arm/test_contract.py"
    )
    assert "skipped" not in output
    assert " passed" in output


def test_frame_refused_by_full_queue_is_sent_again_once():
    output = in_user_mode_linux(sys.executable, "-m", "tests.oracles.full_transmit_queue")
    results = {
        line.split()[0]: line.partition(" ")[2] for line in output.splitlines() if line.strip()
    }
    assert results["FULL"] == "105"  # ENOBUFS
    assert "transmit queue was full for 10 ms" in results["ENDS"]
    assert "sudo ip link set can0 txqueuelen 1000" in results["ENDS"]
    sent, retries = re.fullmatch(r"(\d+) AGAIN (\d+)", results["TAKEN"]).groups()  # type: ignore[union-attr]
    assert int(sent) == 2000
    assert int(retries) > 0


def test_socketcan_agrees_with_can_utils_and_meets_transport_contract():
    # One boot for both, with only the plugins that the project's settings name: an import takes a second.
    peers = f"{shlex.quote(sys.executable)} -m tests.oracles.can_utils_peers"
    contract = shlex.join([
        "env", "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1", sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider",
        "--no-header", "--basetemp=/run/pytest", "--color=no", "-p", "pytest_timeout", "-p", "pytest_asyncio.plugin",
        "-o", "addopts=--import-mode=importlib --strict-markers", "-k", "socketcan",
        "tests/contracts/test_transport_contract.py",
    ])  # fmt: skip
    output = in_user_mode_linux("/bin/sh", "-c", f"{peers} && ip link set vcan0 up && {contract}")
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
    assert "skipped" not in output
    assert int(re.search(r"(\d+) passed", output)[1]) >= 22  # type: ignore[index]
