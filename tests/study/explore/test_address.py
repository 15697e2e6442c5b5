"""Who is answered: loopback names, and pages of this address."""

import http.client
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import taichi_nmm
from tests.study import fake_walker
from tests.study.explore.serving import explorer

pytestmark = pytest.mark.slow

SOCKET = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}  # fmt: skip


@pytest.fixture(scope="module")
def errors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the explorer prints of errors."""
    return tmp_path_factory.mktemp("printed") / "errors.txt"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, errors: Path) -> Iterator[str]:
    pytest.importorskip("bokeh", reason="no bokeh: pip install 'taichi-nmm[explore]'")
    store = tmp_path_factory.mktemp("served") / "store"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        fake_walker.write_plain_store(store)
    with errors.open("w") as printed, explorer(store, printed) as found:
        yield found


def status(address: str, path: str, headers: dict[str, str]) -> int:
    place = urlsplit(address)
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=30)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    found = connection.getresponse().status
    connection.close()
    return found


def test_it_listens_on_the_loopback_alone(address: str) -> None:
    assert urlsplit(address).hostname == "127.0.0.1"
    assert status(address, "/", {}) == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:5006", "127.0.0.1.evil.example", ""]
)
@pytest.mark.parametrize("path", ["/", "/static/js/bokeh.min.js", "/ws", "/metadata"])
def test_other_names_find_nothing(address: str, host: str, path: str) -> None:
    assert status(address, path, {"Host": host}) in (400, 404)


def test_loopback_names_are_answered(address: str) -> None:
    port = urlsplit(address).port
    for name in ("127.0.0.1", f"127.0.0.1:{port}", f"localhost:{port}"):
        assert status(address, "/", {"Host": name}) == 200


def token_of(lasts_s: int = 300) -> str:
    """A token as the page's own script sends it; Bokeh's word for a session is free."""
    from bokeh.util.token import generate_jwt_token

    return generate_jwt_token("stranger", expiration=lasts_s)


def open_socket(address: str, words: str, origin: str | None = None) -> int:
    headers = {**SOCKET, "Origin": origin or address.rstrip("/"), "Sec-WebSocket-Protocol": words}
    return status(address, "/ws", headers)


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", "null"])
def test_a_socket_of_another_page_is_refused(address: str, origin: str) -> None:
    assert open_socket(address, f"bokeh, {token_of()}", origin) == 403


def test_a_socket_without_a_page_s_token_finds_nothing(address: str, errors: Path) -> None:
    assert open_socket(address, f"bokeh, {token_of()}") == 101  # the page's own way works
    huge = "W" * 60_000
    wrong = ["x", "e30", "W10", "IiI", "bnVsbA", "*", "", huge, token_of(lasts_s=-1), "a, b"]
    for words in ["", "bokeh", *(f"bokeh, {token}" for token in wrong)]:
        assert open_socket(address, words) == 404, words[:40]
    time.sleep(0.2)  # a traceback would be printed after the answer
    assert "Traceback" not in errors.read_text()


@pytest.mark.parametrize(
    "path", ["/autoload.js?bokeh-autoload-element=1", "/metadata", "/robots.txt", "/static"]
)
def test_other_sites_cannot_embed_the_page(address: str, path: str) -> None:
    assert status(address, path, {}) == 404
