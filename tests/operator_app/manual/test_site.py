"""The site holds every page, none of its links is dead, and nothing in it is fetched. Needs the extra [docs]."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from operator_app.manual.pages import SECTIONS

ROOT = Path(__file__).resolve().parents[3]


class Fetches(HTMLParser):
    """What a browser fetches by itself to show a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        said = dict(attrs)
        if tag in ("script", "img", "iframe", "source"):
            self.found.append(said.get("src") or "")
        if tag == "link" and said.get("rel") not in ("prev", "next", "canonical"):
            self.found.append(said.get("href") or "")


def test_the_site_is_built_whole_and_needs_no_network(tmp_path):
    pytest.importorskip("material", reason="needs the extra [docs]")
    config = ROOT / "operator_app/manual/mkdocs.yml"
    # mkdocs.yml is strict: a dead link or anchor ends the build.
    words = [sys.executable, "-m", "mkdocs", "build", "-q", "-f", str(config), "-d", str(tmp_path)]
    made = subprocess.run(
        words,
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    topics = [topic for section in SECTIONS.values() for topic in section]
    for topic in ("index", *topics):
        page = (tmp_path / f"{topic}.html").read_text()
        seen = Fetches()
        seen.feed(page)
        assert not [address for address in seen.found if re.match(r"(https?:)?//", address)], topic
    assert "--remounted" in (tmp_path / "commands.html").read_text()
