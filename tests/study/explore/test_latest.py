"""Of what a tab has asked for, the latest is done; nothing comes to a tab that was closed."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from study.explore.server import Latest


class ByHand(Executor):
    """Calls that a test ends."""

    def __init__(self) -> None:
        self.calls: list[tuple[Future[Any], Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **_: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.calls.append((future, args[0]))
        return future


class Tab:
    """What of a document is used."""

    def __init__(self) -> None:
        self.closed: list[Callable[[object], None]] = []

    def on_session_destroyed(self, call: Callable[[object], None]) -> None:
        self.closed.append(call)

    def add_next_tick_callback(self, call: Callable[[], None]) -> None:
        call()


def start() -> tuple[Latest, ByHand, Tab, list[Any], list[BaseException]]:
    tab, executor = Tab(), ByHand()
    done: list[Any] = []
    failed: list[BaseException] = []
    return Latest(tab, executor, done.append, failed.append), executor, tab, done, failed


def test_what_waits_gives_way_to_what_is_newer() -> None:
    latest, executor, _, done, _ = start()
    for number in range(5):
        latest.ask(print, number)
    assert [asked for _, asked in executor.calls] == [0]
    executor.calls[0][0].set_result("zero")
    assert [asked for _, asked in executor.calls] == [0, 4]
    executor.calls[1][0].set_result("four")
    assert done == ["zero", "four"]
    latest.ask(print, 5)
    assert len(executor.calls) == 3


def test_an_error_is_told_and_work_goes_on() -> None:
    latest, executor, _, done, failed = start()
    latest.ask(print, 0)
    latest.ask(print, 1)
    error = ValueError("no")
    executor.calls[0][0].set_exception(error)
    assert failed == [error]
    executor.calls[1][0].set_result("one")
    assert done == ["one"]


def test_a_closed_tab_gets_nothing() -> None:
    latest, executor, tab, done, _ = start()
    latest.ask(print, 0)
    latest.ask(print, 1)
    tab.closed[0](None)
    executor.calls[0][0].set_result("zero")
    assert done == [] and len(executor.calls) == 1
