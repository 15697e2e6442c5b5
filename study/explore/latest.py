"""What a tab has asked for: one call at a time, and of those that wait the latest alone."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from typing import Any

from bokeh.document import Document

Call = tuple[Callable[..., Any], tuple[Any, ...]]


class Latest:
    """Calls of another process, of which a newer one takes the place of the one that waits.

    Args:
        document: of the tab; when it is closed, what still comes is dropped.
        executor: of all tabs.
        done: called with each result, in the page's own loop.
        failed: called with what was raised.
    """

    def __init__(
        self,
        document: Document,
        executor: Executor,
        done: Callable[[Any], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        self._document, self._executor, self._done, self._failed = document, executor, done, failed
        self._waits: Call | None = None
        self._busy = False
        self._closed = False
        document.on_session_destroyed(self._close)

    def ask(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function of an importable module; its result comes to `done`."""
        self._waits = function, arguments
        if not self._busy:
            self._start()

    def _start(self) -> None:
        if self._waits is None or self._closed:
            return
        function, arguments = self._waits
        self._waits, self._busy = None, True
        future = self._executor.submit(function, *arguments)
        future.add_done_callback(self._hand_over)

    def _hand_over(self, future: Future[Any]) -> None:
        """In a thread of the executor: the page's loop does the rest."""
        if not self._closed and not future.cancelled():
            self._document.add_next_tick_callback(partial(self._finish, future))

    def _finish(self, future: Future[Any]) -> None:
        self._busy = False
        error = future.exception()
        try:
            if error is None:
                self._done(future.result())
            else:
                self._failed(error)
        finally:
            self._start()

    def _close(self, _: object) -> None:
        self._closed, self._waits = True, None
