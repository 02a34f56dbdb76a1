#!/usr/bin/env python3
"""Run a command under an emulated PC with Debian's kernel and a vcan0: ``in_qemu.py COMMAND...``.

For processors without User-Mode Linux; needs neither KVM nor privileges, and minutes instead of seconds. The
guest mounts the host's file system read-only over 9p; this file is also its first process. The exit code is the
command's, 99 if the kernel did not run it.

Kernel and modules are those of an installed Debian package linux-image-amd64, or of one that is unpacked in
the folder QEMU_KERNEL_ROOT.
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

from in_user_mode_linux import CAN_MODULES, PATIENCE_S, forward_output, guest

BUSYBOX = Path("/bin/busybox")

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
"""In the order of their dependencies; a kernel may have some of them built in."""

INIT = """#!/bin/busybox sh
for module in /modules/*; do /bin/busybox insmod $module; done
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=512000,cache=loose host /host ||
    exec /bin/busybox poweroff -f
export COMMAND={command}
exec /bin/busybox switch_root /host {python} {script}
"""
"""Has the command, as a kernel command line has 2,048 characters at most."""


def cpio(path: str, mode: int, data: bytes = b"") -> bytes:
    """Return one entry of an initramfs (Documentation/driver-api/early-userspace/buffer-format)."""
    name = path.encode() + b"\0"
    fields = (0, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name), 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + name
    return head + bytes(-len(head) % 4) + data + bytes(-len(data) % 4)


def initramfs(modules: Path, command: list[str]) -> bytes:
    """Return busybox, the modules, and a first process that changes to the host's root."""
    busybox = BUSYBOX.read_bytes()
    if b"ld-linux" in busybox[:4096]:
        sys.exit(f"{BUSYBOX} is not static; install Debian package busybox-static")
    python, script = (shlex.quote(str(word)) for word in (sys.executable, Path(__file__).resolve()))
    folder, program = stat.S_IFDIR | 0o755, stat.S_IFREG | 0o755
    entries = [cpio(name, folder) for name in ("bin", "modules", "host", "dev")]
    entries.append(cpio("bin/busybox", program, busybox))
    init = INIT.format(python=python, script=script, command=shlex.join(command).encode().hex())
    entries.append(cpio("init", program, init.encode()))
    for number, name in enumerate(MODULES):
        for suffix, unpack in ((".ko", bytes), (".ko.xz", lzma.decompress)):
            file = modules / "kernel" / f"{name}{suffix}"
            if file.exists():
                entries.append(cpio(f"modules/{number:02}", program, unpack(file.read_bytes())))
    return b"".join([*entries, cpio("TRAILER!!!", 0)])


def kernels() -> list[tuple[Path, Path]]:
    """Return available kernels and the folders of their modules, the newest last."""
    root = Path(os.environ.get("QEMU_KERNEL_ROOT", "/"))
    pairs = [
        (kernel, root / usr / "lib/modules" / kernel.name.removeprefix("vmlinuz-"))
        for kernel in (root / "boot").glob("vmlinuz-*-amd64")
        for usr in ("", "usr")
    ]
    pairs = [pair for pair in pairs if (pair[1] / "kernel").is_dir()]
    return sorted(pairs, key=lambda pair: [int(n) for n in re.findall(r"\d+", pair[0].name)])


def host(command: list[str]) -> int:
    pairs = kernels()
    if not pairs:
        sys.exit("there is no kernel in /boot; install Debian package linux-image-amd64")
    kernel, modules = pairs[-1]
    with tempfile.NamedTemporaryFile() as image:
        image.write(initramfs(modules, command))
        image.flush()
        result = subprocess.run(
            [
                "qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1024",
                "-nodefaults", "-no-user-config", "-no-reboot", "-display", "none", "-serial", "stdio",
                "-kernel", str(kernel), "-initrd", image.name, "-append", "console=ttyS0 quiet panic=-1",
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
    return forward_output(result.stdout.replace("\r", ""))


if __name__ == "__main__":
    if os.getpid() == 1:
        guest()
    else:
        sys.exit(host(sys.argv[1:]))
