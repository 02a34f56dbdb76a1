"""Whether the top-level names of this program are its own, before anything is imported by them.

PyPI's `fixtures` installs the same name as our package, and others may. Installed after ours it takes its
place, and what fails then fails far from the cause. Knows nothing of what the packages hold.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from pathlib import Path

FIRST_WORDS = {
    "fixtures": b'"""Physical fixtures: endpoint constraints',
    "hardware": b'"""The arm and the bus:',
    "solver": b'"""Kinematics, closure, estimation and planning.',
}
"""How each of our packages begins."""


class ForeignPackageError(ImportError):
    """Another package stands where one of ours should.

    Attributes
    ----------
    name, found
        The top-level name, and the file that Python finds by it.
    """

    def __init__(self, name: str, found: str, owners: Iterable[str]) -> None:
        self.found = found
        owner = " and ".join(owners) or name
        super().__init__(
            f"the name {name!r} belongs to another package here: Python finds {found}, which is not "
            f"part of sarcal (installed by {owner}). sarcal cannot share an environment with it: "
            f"install sarcal in one of its own (python3 -m venv), or remove the other "
            f"(pip uninstall {owner.split(' and ')[0]}) and then repair ours "
            "(pip install --force-reinstall --no-deps sarcal)",
            name=name,
        )


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
        if Path(origin).resolve() != own or not own.read_bytes().startswith(words):
            raise ForeignPackageError(name, origin, _owners(name))


def _owners(name: str) -> list[str]:
    """Distributions other than ours that say they install `name`; looked up only when all is lost."""
    from importlib.metadata import packages_distributions

    return sorted({d for d in packages_distributions().get(name, []) if d != "sarcal"})
