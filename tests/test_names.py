"""One idea, one name: class names and constants across the product."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("operator_app", "hardware", "fixtures", "solver")
PUBLIC_TWICE = {"Arm", "Fixture"}
"""What `import sarcal` offers under the name of the protocol behind it."""


def test_a_class_name_is_defined_once() -> None:
    places = defaultdict(list)
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places[node.name].append(str(path.relative_to(ROOT)))
    twice = {name: found for name, found in places.items() if len(found) > 1}
    assert set(twice) == PUBLIC_TWICE, twice
