"""All actions in Textual's command palette. Knows the table of actions, does nothing itself."""

from __future__ import annotations

from functools import partial
from typing import Any

from textual.command import DiscoveryHit, Hit, Hits, Provider

from operator_app.tui.keys import ACTIONS, Action


def title(action: Action) -> str:
    """What the palette lists: words and key."""
    where = ""
    if len(action.steps) == 1:
        where = f" (step {int(next(iter(action.steps)))})"
    return f"{action.label}{where}  [{action.shown}]"


class ActionProvider(Provider):
    """Every action, found by its words."""

    async def discover(self) -> Hits:
        """List everything before anything is typed."""
        from textual.content import Content

        app: Any = self.app
        for action in ACTIONS:
            yield DiscoveryHit(
                Content(title(action)),
                partial(app.perform_anywhere, action),
                text=title(action),
                help=action.help,
            )

    async def search(self, query: str) -> Hits:
        """Match words."""
        from textual.content import Content

        app: Any = self.app
        matcher = self.matcher(query)
        for action in ACTIONS:
            words = f"{title(action)} {action.help}"
            score = matcher.match(words)
            if score > 0.0:
                yield Hit(
                    score,
                    Content(title(action)),
                    partial(app.perform_anywhere, action),
                    text=title(action),
                    help=action.help,
                )
