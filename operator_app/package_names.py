"""Checks that the top-level packages belong to this program, before they are imported.

PyPI has another package `fixtures`. Installed later, it replaces ours, and errors appear far from the cause.
"""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

DOCSTRING_STARTS = {
    "fixtures": b'"""Physical fixtures: endpoint constraints',
    "hardware": b'"""The arm and the bus:',
    "solver": b'"""Kinematics, closure, estimation and planning.',
}
"""Beginning of the `__init__.py` of each package of this program."""

REPAIR = "pip install --force-reinstall --no-deps FOLDER, the folder or wheel that sarcal came from"


class ForeignPackageError(ImportError):
    """Python finds another package under the name of one of this program's packages."""

    def __init__(self, name: str, location: str, owners: Sequence[str], *, ours: bool) -> None:
        if owners:
            text = (
                f"belongs to another package here: Python finds {location}, which is not part of sarcal "
                f"(installed by {' and '.join(owners)}). The two cannot share an environment: install sarcal in a "
                f"separate one (python3 -m venv), or remove the other package (pip uninstall {owners[0]}) and then "
                f"reinstall sarcal ({REPAIR})"
            )
        elif ours:
            text = f"belongs to another package here: {location} is not sarcal's file; reinstall sarcal ({REPAIR})"
        else:
            text = (
                f"is a package of sarcal, but Python finds {location} before it, a file of no installed package. "
                "Rename or move it, or start sarcal in another folder: files beside a script, in the working "
                "directory and on PYTHONPATH come first"
            )
        super().__init__(f"the name {name!r} {text}", name=name)


def require_own_names() -> None:
    """Check that Python finds this program's `fixtures`, `hardware` and `solver` in the folder of `operator_app`.

    Raises `ForeignPackageError` if a package is missing or is not this program's; the text states the remedy.
    """
    home = Path(__file__).resolve().parents[1]
    for name, first_words in DOCSTRING_STARTS.items():
        spec = importlib.util.find_spec(name)
        origin = "nothing" if spec is None or spec.origin is None else spec.origin
        own = home / name / "__init__.py"
        # If the other package was installed into the same folder, it may have replaced our __init__.py.
        location = Path(origin).resolve()
        if location != own or not own.read_bytes().startswith(first_words):
            owners = _owners(name, location)
            raise ForeignPackageError(name, origin, owners, ours=location == own or spec is None)


def _owners(name: str, location: Path) -> list[str]:
    from importlib.metadata import files, packages_distributions

    others = {d for d in packages_distributions().get(name, []) if d != "sarcal"}
    return sorted(
        other
        for other in others
        if any(Path(str(file.locate())).resolve() == location for file in files(other) or ())
    )
