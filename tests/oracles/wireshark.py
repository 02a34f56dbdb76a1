"""Frames of a recorded bus as Wireshark's CANopen dissector reads them, which nobody here wrote."""

import subprocess
from pathlib import Path


def dissected(file: Path, *fields: str) -> list[list[str]]:
    """One row a frame, in the file's order; of a field that a frame lacks an empty text."""
    arguments = [
        "tshark", "-r", str(file), "-d", "can.subdissector,canopen",
        "-T", "fields",
    ]  # fmt: skip
    for field in fields:
        arguments += ["-e", field]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=60)
    return [line.split("\t") for line in done.stdout.splitlines()]
