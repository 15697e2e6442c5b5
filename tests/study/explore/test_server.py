"""The page's server: whom it answers, calls of which the latest counts, and the message line."""

import http.client
import signal
import time
from concurrent.futures import Future
from contextlib import closing
from typing import Any
from unittest.mock import Mock, call
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from tornado.ioloop import IOLoop

from study.explore.server import OURS, Latest, Message, run
from tests.study import fake_walker
from tests.study.explore.serving import explorer

pytestmark = pytest.mark.slow

LACKED = "libX11.so.6: cannot open shared object file: No such file or directory"
SOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """What the explorer prints of errors."""
    return tmp_path_factory.mktemp("printed") / "errors.txt"


@pytest.fixture(scope="module")
def address(tmp_path_factory, errors):
    pytest.importorskip("bokeh", reason="no bokeh: pip install 'taichi-nmm[explore]'")
    store = tmp_path_factory.mktemp("served") / "store"
    fake_walker.write_plain_store(store)
    with errors.open("w") as printed, explorer(store, errors=printed) as found:
        yield found


def status(address, path, headers):
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=30)
    with closing(connection):
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status


def test_it_listens_on_the_loopback_alone_and_has_no_other_doors(address):
    assert urlsplit(address).hostname == "127.0.0.1"
    assert status(address, "/", {}) == 200
    port = urlsplit(address).port
    for name in ("127.0.0.1", f"127.0.0.1:{port}", f"localhost:{port}"):
        assert status(address, "/", {"Host": name}) == 200
    # Other sites cannot embed the page.
    embedding = "/page/autoload.js?bokeh-autoload-element=1"
    for path in (embedding, "/page/metadata", "/robots.txt", "/static"):
        assert status(address, path, {}) == 404


def test_a_sign_comes_before_the_page_which_takes_seconds(address):
    found = [urlopen(f"{address}{query}").read().decode() for query in ("", "page")]
    assert "The page opens" in found[0] and 'replace("/page")' in found[0]
    assert "Bokeh" not in found[0] and "Bokeh" in found[1]


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""]
)
@pytest.mark.parametrize(
    "path", ["/", "/static/js/bokeh.min.js", "/page/ws", "/page/metadata"]
)
def test_other_names_find_nothing(address, host, path):
    assert status(address, path, {"Host": host}) in (400, 404)


def token_of(lasts_s=300):
    """A token as the page's own script sends it; Bokeh's word for a session is free."""
    from bokeh.util.token import generate_jwt_token

    return generate_jwt_token("stranger", expiration=lasts_s)


def open_socket(address, words, origin=None):
    headers = {
        **SOCKET,
        "Origin": origin or address.rstrip("/"),
        "Sec-WebSocket-Protocol": words,
    }
    return status(address, "/page/ws", headers)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:1", "null"]
)
def test_a_socket_of_another_page_is_refused(address, origin):
    assert open_socket(address, f"bokeh, {token_of()}", origin) == 403


def test_a_socket_without_a_page_s_token_finds_nothing(address, errors):
    # The page's own way works.
    assert open_socket(address, f"bokeh, {token_of()}") == 101
    late, huge = token_of(lasts_s=-1), "W" * 60_000
    wrong = ["x", "e30", "W10", "IiI", "bnVsbA", "*", "", huge, late, "a, b"]
    for words in ["", "bokeh", *(f"bokeh, {token}" for token in wrong)]:
        assert open_socket(address, words) == 404, words[:40]
    time.sleep(0.2)  # a traceback would be printed after the answer
    assert "Traceback" not in errors.read_text()


def start():
    """With its tab, executor and callbacks in one, and the calls that a test ends."""
    calls, all_else = [Future[Any]() for _ in range(3)], Mock()
    all_else.submit.side_effect = calls
    all_else.add_next_tick_callback = lambda task: task()  # at once
    return Latest(all_else, all_else, all_else.done, all_else.failed), all_else, calls


def test_what_waits_gives_way():
    latest, seen, calls = start()
    for number in range(5):
        latest.ask(print, number)
    assert seen.submit.mock_calls == [call(print, 0)]
    calls[0].set_result("zero")
    assert seen.submit.mock_calls == [call(print, 0), call(print, 4)]
    calls[1].set_result("four")
    assert seen.done.mock_calls == [call("zero"), call("four")]
    latest.ask(print, 5)
    assert seen.submit.call_count == 3


def test_an_error_is_told_and_what_waits_comes_after_it():
    latest, seen, calls = start()
    latest.ask(print, 0)
    latest.ask(print, 1)
    error = ValueError("no")
    calls[0].set_exception(error)
    assert seen.failed.mock_calls == [call(error)]
    calls[1].set_result("one")
    assert seen.done.mock_calls == [call("one")]


def test_a_closed_tab_gets_nothing():
    latest, seen, calls = start()
    latest.ask(print, 0)
    latest.ask(print, 1)
    (close,) = seen.on_session_destroyed.call_args.args
    close(None)
    calls[0].set_result("zero")
    assert not seen.done.called and seen.submit.call_count == 1


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            ModuleNotFoundError("No module named 'mujoco'", name="mujoco"),
            "package: 'mujoco' is not installed; allowed: an environment that has it",
        ),
        (
            ImportError(
                LACKED, name="taichi_python", path="/lib/taichi_python.abi3.so"
            ),
            f"taichi_python: '{LACKED}' cannot be used; "
            "allowed: a machine with the libraries that taichi_python needs (README.md)",
        ),
    ],
)
def test_what_the_machine_lacks_is_said(error, said):
    message = Message("message")
    message.failed(error)
    assert message.layout.text == said.replace("'", "&#x27;")


def test_a_mistake_of_ours_is_called_so(capsys):
    message = Message("message")
    message.failed(
        ImportError("cannot import name 'x'", name="study.view", path="/study/view.py")
    )
    assert message.layout.text == OURS
    assert "cannot import name 'x'" in capsys.readouterr().err


class Freed:
    """An object during whose end Ctrl-C is typed."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def test_ctrl_c_is_not_lost_while_an_object_is_freed():
    before, late = signal.getsignal(signal.SIGINT), Mock()
    loop = IOLoop(make_current=False)
    for wait_s, called in ((0.0, Freed), (20.0, late), (20.0, loop.stop)):
        loop.call_later(wait_s, called)
    run(loop)
    assert not late.called
    assert signal.getsignal(signal.SIGINT) is before
    loop.close()
