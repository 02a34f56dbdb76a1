"""A scripted operator of plain mode, who selects menu items by their labels."""

import threading
from collections.abc import Callable

WORK = threading.Event()


def pause_briefly(pause_s: float) -> None:
    """Pause for a fiftieth of the time: polling without a pause would slow down the session's threads."""
    WORK.wait(pause_s / 50.0)


class Script:
    """A terminal with these answers; `lines` are written to it."""

    def __init__(self, *answers: str | Callable[[], str]) -> None:
        self.answers = iter(answers)
        self.lines: list[str] = []
        self.key_pressed_when: Callable[[], bool] = lambda: False

    def say(self, text: str) -> None:
        self.lines += text.splitlines()

    def ask(self, prompt: str) -> str:
        self.lines.append(prompt)
        try:
            answer = next(self.answers)
        except StopIteration as end:
            raise EOFError from end
        if callable(answer):
            return answer()
        if prompt not in ("Number: ", "Which: "):
            return answer
        for row in reversed(self.lines):
            number, _, label = row.strip().partition(" ")
            if number.isdecimal() and label.startswith(answer):
                return number
        assert prompt != "Number: ", f"no item {answer!r} in {self.lines[-12:]}"
        return answer

    def touched(self, timeout_s: float) -> bool:
        pause_briefly(timeout_s)
        return self.key_pressed_when()
