"""The site has every page, valid links, and no resources from the network. Needs the extra [docs]."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from operator_app.manual.pages import SECTIONS

ROOT = Path(__file__).resolve().parents[3]


class FetchedAddresses(HTMLParser):
    """Addresses that a browser fetches to show a page."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        if tag in ("script", "img", "iframe", "source"):
            self.addresses.append(attributes.get("src") or "")
        if tag == "link" and attributes.get("rel") not in ("prev", "next", "canonical"):
            self.addresses.append(attributes.get("href") or "")


def test_site_has_every_page_and_needs_no_network(tmp_path):
    pytest.importorskip("material", reason="needs the extra [docs]")
    config = ROOT / "operator_app/manual/mkdocs.yml"
    # mkdocs.yml is strict: an invalid link or anchor fails the build.
    options = ["build", "-q", "-f", str(config), "-d", str(tmp_path)]
    build = subprocess.run(
        [sys.executable, "-m", "mkdocs", *options],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert build.returncode == 0, build.stderr
    topics = [topic for section in SECTIONS.values() for topic in section]
    for topic in ("index", *topics):
        page = (tmp_path / f"{topic}.html").read_text()
        parser = FetchedAddresses()
        parser.feed(page)
        external = [a for a in parser.addresses if re.match(r"(https?:)?//", a)]
        assert not external, topic
    assert "--remounted" in (tmp_path / "commands.html").read_text()
