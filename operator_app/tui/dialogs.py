"""Dialogs over the main screen, below the safety strip; the focus is on Cancel, if there is one."""

from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Input, OptionList, Static
from textual.widgets.option_list import Option

from operator_app.safe_output import sanitized
from operator_app.session.ui.user_interface import OneOf, Question, Titled, Typed, YesNo
from operator_app.tui.lines import app_of
from operator_app.tui.theme import is_compact

Shown = TypeVar("Shown", bound=Titled)


class Dialog(ModalScreen[str | None], Generic[Shown]):
    """A box with a title and a text; Esc, n and q close it with the answer None."""

    AUTO_FOCUS = ""
    FOCUS: ClassVar[str]
    """Selector of the widget that has the focus first, even while the terminal is in the background."""
    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,n,q", "dismiss", show=False)]

    def __init__(self, question: Shown) -> None:
        super().__init__()
        self._question = question

    def on_mount(self) -> None:
        """Focus the widget `FOCUS`; `AUTO_FOCUS` would do so only while the terminal is in the foreground."""
        self.query_one(self.FOCUS).focus()

    def on_resize(self, event: events.Resize) -> None:
        """Choose the layout in which the dialog covers neither the safety strip nor the list of steps."""
        self.set_class(is_compact(*event.size), "-compact")
        self.set_class(app_of(self).look.ascii_only, "-ascii")

    def compose(self) -> ComposeResult:
        """Compose the title, the text and the body."""
        with Vertical(id="box") as box:
            box.border_title = self._plain(self._question.title)
            yield Static(self._plain(self._question.text), id="text")
            yield from self.body()

    def body(self) -> ComposeResult:
        """Return the widgets below the text."""
        yield from ()

    def _plain(self, text: str) -> Any:
        return Content(app_of(self).look.text(text))


class Confirm(Dialog[YesNo]):
    """A dialog with the buttons Yes and Cancel."""

    FOCUS = "#cancel"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss('yes')", show=False),
        Binding("left,right,tab,shift+tab", "app.focus_next", show=False),
    ]

    def body(self) -> ComposeResult:
        """Yield two buttons, Cancel first."""
        with Horizontal(id="buttons"):
            yield Button(self._plain(f"{self._question.no}  Esc"), id="cancel", compact=True)
            yield Button(self._plain(f"{self._question.yes}  y"), id="yes", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Close the dialog with the answer ``yes`` or, for Cancel, None."""
        self.dismiss("yes" if event.button.id == "yes" else None)


class Ask(Dialog[Typed]):
    """A dialog with an input line; if the question has an expected text, only that text is accepted."""

    FOCUS = "Input"

    def body(self) -> ComposeResult:
        """Yield an input field, and the line that shows instructions or a refusal."""
        yield Input(value=sanitized(self._question.value), id="answer", compact=True)
        yield Static(self._plain("Enter accepts, Esc cancels"), id="said")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Accept the text, or show why it is refused."""
        typed, expected = event.value.strip(), self._question.expected
        if expected and typed != expected:
            refusal = self._plain(f"▲ that is not {expected}: nothing was sent")
            self.query_one("#said", Static).update(refusal)
            return
        self.dismiss(typed)


class Choose(Dialog[OneOf]):
    """A dialog with a list of options."""

    FOCUS = "OptionList"

    def body(self) -> ComposeResult:
        """Yield the list of options, Cancel first."""
        cancel = Option(self._plain("Cancel"), id="")
        rows = [Option(self._plain(text), id=key) for key, text in self._question.options]
        yield OptionList(cancel, *rows, id="options", compact=True)

    def on_mount(self) -> None:
        """Highlight the option Cancel."""
        self.query_one(OptionList).highlighted = 0

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Close the dialog with the key of the option or, for Cancel, None."""
        self.dismiss(event.option.id or None)


class Read(Dialog[Titled]):
    """A dialog with a text to read; Esc, q, Enter and ? close it."""

    FOCUS = "#box"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter,question_mark,f1", "dismiss", show=False)
    ]

    def __init__(self, title: str, text: str) -> None:
        super().__init__(Titled(title=title, text=text))

    def compose(self) -> ComposeResult:
        """Compose the scrollable text."""
        with VerticalScroll(id="box", classes="tall") as box:
            box.border_title = self._plain(self._question.title)
            box.border_subtitle = self._plain("Esc closes")
            yield Static(self._plain(self._question.text), id="text")


DIALOGS: Mapping[type[Question], type[Dialog[Any]]] = {YesNo: Confirm, Typed: Ask, OneOf: Choose}
