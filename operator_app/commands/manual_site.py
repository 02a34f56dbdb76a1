"""Hooks of mkdocs for the manual site, named in `operator_app/manual/mkdocs.yml`. Needs the extra ``[docs]``."""

from __future__ import annotations

from typing import Any

from operator_app.commands.help_topic import manual
from operator_app.manual.pages import SECTIONS


def on_config(config: Any) -> Any:
    """Set the navigation from the table of topics."""
    sections = [{name: [f"{topic}.md" for topic in topics]} for name, topics in SECTIONS.items()]
    config.nav = [{"Start": "index.md"}, *sections]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages."""
    from mkdocs.structure.files import File  # type: ignore[import-not-found,import-untyped,unused-ignore]

    found = manual()
    for topic in found.topics:
        if found.made_by_code(topic):
            page = found.page(topic).markdown
            files.append(File.generated(config, f"{topic}.md", content=page))
    return files
