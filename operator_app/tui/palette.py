"""Lists all actions in Textual's command palette."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from textual.command import DiscoveryHit, Hit, Hits, Provider
from textual.content import Content


class ActionProvider(Provider):
    """Provides all actions to the palette, where they are found by their words."""

    def _all(self) -> Iterator[tuple[str, dict[str, Any]]]:
        from operator_app.session.ui import action_table

        app: Any = self.app
        for action in action_table.ACTIONS:
            where = f" (step {int(*action.steps)})" if len(action.steps) == 1 else ""
            text = f"{action.label}{where}  [{action.shown}]"
            command = partial(app.interface.do_anywhere, action)
            yield text, {"command": command, "text": text, "help": action.help}

    async def discover(self) -> Hits:
        """Yield all actions, before anything is typed."""
        for text, shown in self._all():
            yield DiscoveryHit(Content(text), **shown)

    async def search(self, query: str) -> Hits:
        """Yield the actions whose words match."""
        matcher = self.matcher(query)
        for text, shown in self._all():
            score = matcher.match(f"{text} {shown['help']}")
            if score > 0.0:
                yield Hit(score, Content(text), **shown)
