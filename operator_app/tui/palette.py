"""Lists all actions in Textual's command palette."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from textual.command import DiscoveryHit, Hit, Hits, Provider
from textual.content import Content

if TYPE_CHECKING:
    from operator_app.session.ui.user_interface import Entry


def title(action: Entry) -> str:
    """Return the text of an action in the palette: label, step (if only one), key."""
    where = ""
    if len(action.steps) == 1:
        where = f" (step {int(next(iter(action.steps)))})"
    return f"{action.label}{where}  [{action.shown}]"


class ActionProvider(Provider):
    """Provides all actions to the palette, where they are found by their words."""

    def _all(self) -> Iterator[tuple[Entry, dict[str, Any]]]:
        """Yield every action with its data for the palette: the function that performs it, text, and help."""
        from operator_app.session.ui import action_table

        app: Any = self.app
        for action in action_table.ACTIONS:
            yield (
                action,
                {
                    "command": partial(app.interface.do_anywhere, action),
                    "text": title(action),
                    "help": action.help,
                },
            )

    async def discover(self) -> Hits:
        """Yield all actions, before anything is typed."""
        for action, shown in self._all():
            yield DiscoveryHit(Content(title(action)), **shown)

    async def search(self, query: str) -> Hits:
        """Yield the actions whose words match."""
        matcher = self.matcher(query)
        for action, shown in self._all():
            score = matcher.match(f"{title(action)} {action.help}")
            if score > 0.0:
                yield Hit(score, Content(title(action)), **shown)
