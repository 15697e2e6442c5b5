"""What is said at the top of the page: bad input in one line, as on a command line."""

import html
import sys
import traceback
from collections.abc import Callable
from typing import Any

from bokeh.models import Div

from study.cli import what_is_missing
from taichi_nmm.errors import InputError

WARNING = "#B3261E"
OURS = "this did not work; what went wrong stands where the command was started"


class Message:
    """One line, and whatever calls of the page's models have to say."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.layout = Div(text="", name="message", height=20, styles={"color": WARNING})

    def tell(self, text: str) -> None:
        """Say this in place of what was said before."""
        self.layout.text = html.escape(text)

    def failed(self, error: BaseException) -> None:
        """Say what a call raised: the line of bad input, or that the mistake is ours."""
        if isinstance(error, InputError):
            self.tell(str(error))
        elif isinstance(error, ImportError) and (missing := what_is_missing(error)) is not None:
            self.tell(missing)
        else:
            traceback.print_exception(error, file=sys.stderr)
            self.tell(OURS)

    def safely(self, call: Callable[[], None]) -> Callable[[], None]:
        """The same call, whose errors are said."""

        def answer() -> None:
            try:
                call()
            except Exception as error:
                self.failed(error)

        return answer

    def watch(self, model: Any, attribute: str, call: Callable[[], None]) -> None:
        """Call when an attribute of a model has changed."""
        answer = self.safely(call)
        model.on_change(attribute, lambda attr, old, new: answer())
