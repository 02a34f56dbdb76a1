#!/usr/bin/env python3
"""Run a command under a User-Mode Linux kernel that has a real vcan0: ``in_user_mode_linux.py COMMAND...``.

The guest mounts the host's file system read-only; this file is also its first process. The exit code is the
command's, 99 if the kernel did not run it.
"""

import ctypes
import os
import shlex
import subprocess
import sys
from pathlib import Path

KERNEL, MODULES = "/usr/bin/linux.uml", "/usr/lib/uml/modules"
PATIENCE_S = 900.0
NOT_RUN = 99
EXIT_CODE = "UML_RC="

# In the order of their dependencies.
CAN_MODULES = (
    "net/can/can",
    "net/can/can-raw",
    "net/can/can-bcm",
    "drivers/net/can/dev/can-dev",
    "drivers/net/can/vcan",
)
FINIT_MODULE = 313
POWER_OFF = 0x4321FEDC


def host(command: list[str]) -> int:
    """Boot the kernel with this file as its init and return the command's exit code."""
    settings = {
        "mem": "512M",
        "root": "/dev/root",
        "rootfstype": "hostfs",
        "rootflags": "/",
        "init": str(Path(__file__).resolve()),
        "con": "null",
        "con0": "fd:0,fd:1",
        # Parameters unknown to the kernel become environment variables of its init.
        "COMMAND": shlex.join(command).encode().hex(),
    }
    result = subprocess.run(
        [KERNEL, *(f"{key}={value}" for key, value in settings.items()), "ro", "quiet"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=PATIENCE_S,
        env={key: os.environ[key] for key in ("HOME", "PATH", "TMPDIR") if key in os.environ},
        check=False,
    )
    return forward_output(result.stdout)


def forward_output(output: str) -> int:
    """Print the guest's output and return its command's exit code."""
    sys.stdout.write(output)
    codes = [line for line in output.splitlines() if line.startswith(EXIT_CODE)]
    return int(codes[-1].removeprefix(EXIT_CODE)) if codes else NOT_RUN


def guest(*modules: str) -> None:
    """Mount file systems, load modules, set vcan0 up, run the command, power off."""
    libc = ctypes.CDLL(None, use_errno=True)
    for source, target, kind in (
        ("proc", "/proc", "proc"),
        ("sys", "/sys", "sysfs"),
        ("tmpfs", "/run", "tmpfs"),
    ):
        libc.mount(source.encode(), target.encode(), kind.encode(), 0, None)
    kernel = Path(MODULES) / os.uname().release / "kernel"
    for name in modules:
        module = os.open(kernel / f"{name}.ko", os.O_RDONLY)
        if libc.syscall(FINIT_MODULE, module, b"", 0):
            print("cannot load", name, os.strerror(ctypes.get_errno()))
    os.environ["PATH"] = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
    for line in ("link add vcan0 type vcan", "link set vcan0 up", "link set lo up"):
        subprocess.run(["ip", *line.split()], check=True)
    result = subprocess.run(
        shlex.split(bytes.fromhex(os.environ["COMMAND"]).decode()),
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        check=False,
    )
    print(f"{EXIT_CODE}{result.returncode}", flush=True)
    os.sync()
    libc.reboot(POWER_OFF)


if __name__ == "__main__":
    if os.getpid() == 1:
        guest(*CAN_MODULES)
    else:
        sys.exit(host(sys.argv[1:]))
