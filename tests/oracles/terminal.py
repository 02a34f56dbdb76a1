"""A program in a tmux pane of fixed size, polled for its screen."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path

_numbers = count()
PATIENCE_S = 60.0
POLL_S = 0.05


class Terminal:
    """One program in `folder`, in a pane of `size` columns and rows; `environment` extends this process's."""

    def __init__(
        self,
        folder: Path,
        command: Sequence[str],
        *,
        size: tuple[int, int],
        environment: dict[str, str] | None = None,
    ) -> None:
        self._socket = str(folder / f"tmux-{next(_numbers)}.sock")
        self._done = folder / "exit-code"
        self._done.unlink(missing_ok=True)
        quoted = " ".join(f"'{word}'" for word in command)
        settings = " ".join(f"{k}='{v}'" for k, v in (environment or {}).items())
        script = f"cd '{folder}' && env {settings} {quoted}; echo $? > '{self._done}'; exec cat"
        unwanted = ("TMUX", "NO_COLOR", "COLUMNS", "LINES")
        plain = {k: v for k, v in os.environ.items() if k not in unwanted}
        subprocess.run(
            ["tmux", "-S", self._socket, "-f", os.devnull, "new-session", "-d",
             "-x", str(size[0]), "-y", str(size[1]), script],
            check=True, env={**plain, "TERM": "xterm-256color", "LC_ALL": "C.UTF-8"},
        )  # fmt: skip
        self._tmux("set-option", "-g", "status", "off")
        self._tmux("resize-window", "-x", str(size[0]), "-y", str(size[1]))

    def _tmux(self, *words: str) -> str:
        done = subprocess.run(
            ["tmux", "-S", self._socket, *words], check=True, capture_output=True, text=True
        )
        return done.stdout

    def screen(self, *, with_colours: bool = False) -> str:
        return self._tmux("capture-pane", "-p", *(["-e"] if with_colours else []))

    def keys(self, *names: str) -> None:
        for name in names:
            self._tmux("send-keys", name)

    def until(self, shows: str | Callable[[str], bool]) -> str:
        """Wait until the screen contains a text or meets a condition, and return it."""
        end = time.monotonic() + PATIENCE_S
        while True:
            screen = self.screen()
            if shows in screen if isinstance(shows, str) else shows(screen):
                return screen
            if time.monotonic() > end:
                raise AssertionError(f"never shown: {shows}\n{screen}")
            select(POLL_S)

    def pid(self) -> int:
        shell = self._tmux("display-message", "-p", "#{pane_pid}").strip()
        children = Path(f"/proc/{shell}/task/{shell}/children").read_text().split()
        return int(children[0])

    def kill(self, number: signal.Signals) -> None:
        os.kill(self.pid(), number)

    def exit_code(self) -> int:
        end = time.monotonic() + PATIENCE_S
        while not (self._done.is_file() and self._done.read_text()):
            if time.monotonic() > end:
                raise AssertionError(f"the program still runs\n{self.screen()}")
            select(POLL_S)
        return int(self._done.read_text())

    def close(self) -> None:
        """End tmux and its program; may be called twice."""
        subprocess.run(
            ["tmux", "-S", self._socket, "kill-server"], check=False, capture_output=True
        )


def select(seconds: float) -> None:
    """Sleep."""
    signal.sigtimedwait([], seconds)
