"""What a result was computed with: the versions of this program and of the libraries whose digits it prints."""

from __future__ import annotations

import platform
from importlib.metadata import version


def versions() -> dict[str, str]:
    """Return versions by name, as the journal keeps them."""
    libraries = {name: version(name) for name in ("sarcal", "numpy", "scipy")}
    return libraries | {"python": platform.python_version()}


def software_version() -> str:
    """Return them as one line: ``0.3.0 (numpy 2.3.5, scipy 1.16.3, python 3.11.2)``."""
    own, *others = versions().items()
    return f"{own[1]} ({', '.join(f'{name} {number}' for name, number in others)})"
