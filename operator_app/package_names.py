"""Whether the top-level names of this program are its own, before anything is imported by them.

PyPI's `fixtures` installs the same name as our package, and others may. Installed after ours it takes its
place, and what fails then fails far from the cause. Knows nothing of what the packages hold.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path

FIRST_WORDS = {
    "fixtures": b'"""Physical fixtures: endpoint constraints',
    "hardware": b'"""The arm and the bus:',
    "solver": b'"""Kinematics, closure, estimation and planning.',
}
"""How each of our packages begins."""

REPAIR = "pip install --force-reinstall --no-deps sarcal"


class ForeignPackageError(ImportError):
    """Another package stands where one of ours should.

    Attributes
    ----------
    name, found
        The top-level name, and the file that Python finds by it.
    """

    def __init__(self, name: str, found: str, owners: Sequence[str], *, ours: bool) -> None:
        self.found = found
        if owners:
            said = (
                f"belongs to another package here: Python finds {found}, which is not part of sarcal "
                f"(installed by {' and '.join(owners)}). sarcal cannot share an environment with it: install "
                "sarcal in one of its own (python3 -m venv), or remove the other "
                f"(pip uninstall {owners[0]}) and then repair ours ({REPAIR})"
            )
        elif ours:
            said = f"belongs to another package here: {found} is not as sarcal has it; repair it ({REPAIR})"
        else:
            said = (
                f"is a part of sarcal, and Python finds {found} before it, which no installed package "
                "brought. Rename or move it, or start elsewhere: files beside a script, in the working "
                "directory and on PYTHONPATH come first"
            )
        super().__init__(f"the name {name!r} {said}", name=name)


def require_own_names() -> None:
    """Make sure that our packages are found beside this one, as they were installed.

    Raises
    ------
    ForeignPackageError
        One of them is not, with what to do.
    """
    home = Path(__file__).resolve().parents[1]
    for name, words in FIRST_WORDS.items():
        spec = importlib.util.find_spec(name)
        origin = "nothing" if spec is None or spec.origin is None else spec.origin
        own = home / name / "__init__.py"
        # Where both were installed into one folder, the other's __init__.py may lie in it.
        found = Path(origin).resolve()
        if found != own or not own.read_bytes().startswith(words):
            owners = _owners(name, found)
            raise ForeignPackageError(name, origin, owners, ours=found == own or spec is None)


def _owners(name: str, found: Path) -> list[str]:
    """Distributions other than ours that installed the file found; looked up only when all is lost."""
    from importlib.metadata import files, packages_distributions

    others = {d for d in packages_distributions().get(name, []) if d != "sarcal"}
    return sorted(
        other
        for other in others
        if any(Path(str(file.locate())).resolve() == found for file in files(other) or ())
    )
