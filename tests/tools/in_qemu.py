#!/usr/bin/env python3
"""Run a command under an emulated PC with Debian's kernel and a vcan0: ``in_qemu.py COMMAND...``.

For processors that User-Mode Linux does not run on; needs no KVM and no privileges, and minutes where that
takes seconds. The host's file system is the guest's, read-only, over 9p; this file is the guest's first
process as well. The exit code is the command's, 99 if the kernel never got that far.

Kernel and modules are those of an installed Debian package linux-image-amd64, or of one that was unpacked
into the folder that QEMU_KERNEL_ROOT names.
"""

import lzma
import os
import re
import shlex
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

from in_user_mode_linux import CAN_MODULES, PATIENCE_S, guest, passed_on

BUSYBOX = Path("/bin/busybox")

# In the order in which they need each other.
MODULES = (
    "drivers/virtio/virtio_ring",
    "drivers/virtio/virtio",
    "drivers/virtio/virtio_pci_modern_dev",
    "drivers/virtio/virtio_pci_legacy_dev",
    "drivers/virtio/virtio_pci",
    "fs/netfs/netfs",
    "fs/fscache/fscache",
    "net/9p/9pnet",
    "net/9p/9pnet_virtio",
    "fs/9p/9p",
    *CAN_MODULES,
)
"""A kernel may have some of them built in, or in one with another."""

INIT = """#!/bin/busybox sh
for module in /modules/*; do /bin/busybox insmod $module; done
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=512000,cache=loose host /host ||
    exec /bin/busybox poweroff -f
export COMMAND={command}
exec /bin/busybox switch_root /host {python} {script}
"""
"""The command goes in here: a kernel's own line ends after 2,048 characters."""


def cpio(path: str, mode: int, data: bytes = b"") -> bytes:
    """One entry of an initramfs (Documentation/driver-api/early-userspace/buffer-format)."""
    name = path.encode() + b"\0"
    fields = (0, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name), 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + name
    return head + bytes(-len(head) % 4) + data + bytes(-len(data) % 4)


def initramfs(modules: Path, command: list[str]) -> bytes:
    """What the kernel starts with: busybox, the modules, and a first process that goes over to the host's root."""
    busybox = BUSYBOX.read_bytes()
    if b"ld-linux" in busybox[:4096]:
        sys.exit(f"{BUSYBOX} is not static; install Debian package busybox-static")
    python, script = (shlex.quote(str(word)) for word in (sys.executable, Path(__file__).resolve()))
    folder, program = stat.S_IFDIR | 0o755, stat.S_IFREG | 0o755
    entries = [cpio(name, folder) for name in ("bin", "modules", "host", "dev")]
    entries.append(cpio("bin/busybox", program, busybox))
    first = INIT.format(python=python, script=script, command=shlex.join(command).encode().hex())
    entries.append(cpio("init", program, first.encode()))
    for number, name in enumerate(MODULES):
        for ending, unpacked in ((".ko", bytes), (".ko.xz", lzma.decompress)):
            file = modules / "kernel" / f"{name}{ending}"
            if file.exists():
                entries.append(cpio(f"modules/{number:02}", program, unpacked(file.read_bytes())))
    return b"".join([*entries, cpio("TRAILER!!!", 0)])


def kernels() -> list[tuple[Path, Path]]:
    """Kernels there are and the folders of their modules, the newest last."""
    root = Path(os.environ.get("QEMU_KERNEL_ROOT", "/"))
    found = [
        (kernel, root / usr / "lib/modules" / kernel.name.removeprefix("vmlinuz-"))
        for kernel in (root / "boot").glob("vmlinuz-*-amd64")
        for usr in ("", "usr")
    ]
    whole = [pair for pair in found if (pair[1] / "kernel").is_dir()]
    return sorted(whole, key=lambda pair: [int(n) for n in re.findall(r"\d+", pair[0].name)])


def host(command: list[str]) -> int:
    """Boot the kernel and return the command's exit code."""
    found = kernels()
    if not found:
        sys.exit("there is no kernel in /boot; install Debian package linux-image-amd64")
    kernel, modules = found[-1]
    with tempfile.NamedTemporaryFile() as start:
        start.write(initramfs(modules, command))
        start.flush()
        done = subprocess.run(
            [
                "qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1024",
                "-nodefaults", "-no-user-config", "-no-reboot", "-display", "none", "-serial", "stdio",
                "-kernel", str(kernel), "-initrd", start.name, "-append", "console=ttyS0 quiet panic=-1",
                "-fsdev", "local,id=root,path=/,security_model=none,readonly=on,multidevs=remap",
                "-device", "virtio-9p-pci,fsdev=root,mount_tag=host",
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            errors="replace",
            timeout=PATIENCE_S,
            check=False,
        )  # fmt: skip
    return passed_on(done.stdout.replace("\r", ""))


if __name__ == "__main__":
    if os.getpid() == 1:
        guest()
    else:
        sys.exit(host(sys.argv[1:]))
