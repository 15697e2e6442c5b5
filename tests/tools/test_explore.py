"""taichi-nmm explore: what it refuses, in one line, and the page without a browser."""

import json
import os
import selectors
import shutil
import socket
import sys
import urllib.request
from contextlib import suppress

import pytest

from tests.processes import printed, serving
from tests.study import fake_walker
from tests.tools.running import load_command

pytestmark = pytest.mark.slow

INSTEAD = "folder: .*: a store or a study database; for others: taichi-nmm report, "


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    pytest.importorskip("bokeh", reason="no bokeh: pip install 'taichi-nmm[explore]'")
    path = tmp_path_factory.mktemp("made") / "store"
    fake_walker.write_plain_store(path)
    return path


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere", "store: "),
        ("empty", "store: "),
        ("file", "store: "),
        ("compared", INSTEAD),
        ("newer", "store: .*of format 99"),
        ("walk.toml", INSTEAD),
    ],
)
def test_bad_input(name, message, store, tmp_path, tool):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("no store")
    (tmp_path / "compared").mkdir()
    (tmp_path / "compared" / "experiment.json").write_text("[]")
    manifest = shutil.copytree(store, tmp_path / "newer") / "manifest.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"format": 99}))
    tool.refuses(message, "explore", tmp_path / name, "--no-browser")


def test_without_bokeh_it_says_so(store, tool, monkeypatch):
    for name in list(sys.modules):
        if name.startswith("study.explore"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    tool.refuses("package: 'bokeh' is not installed", "explore", store, "--no-browser")


def test_a_port_in_use(store, tool):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        message = f"port: {port} cannot be used; allowed: a free port"
        tool.refuses(message, "explore", store, "--no-browser", "--port", port)


def test_a_request_waits_for_the_page_while_the_command_starts(store):
    """It is taken before the packages of the page are loaded, which takes seconds."""
    loaded = "import study.commands.explore, sys; print('bokeh' in sys.modules)"
    assert printed("-c", loaded).strip() == "False"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    words = ("-m", "taichi_nmm", "explore", store, "--port", port, "--no-browser")
    with serving(*words) as said:
        asked = wait_until_taken(port)
        with selectors.DefaultSelector() as waiting:
            waiting.register(said, selectors.EVENT_READ)
            assert not waiting.select(0.0)  # the address is said when the page is ready
        with asked:
            asked.sendall(f"GET / HTTP/1.0\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            assert asked.makefile("rb").readline().split()[1] == b"200"


def wait_until_taken(port):
    while True:
        with suppress(ConnectionRefusedError):
            return socket.create_connection(("127.0.0.1", port), timeout=60)


def test_a_browser_of_a_terminal_is_not_opened(monkeypatch):
    explore = load_command("explore")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in explore.DISPLAYS:
        monkeypatch.setenv(name, "")
    assert not explore.has_display()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert explore.has_display()


def test_without_a_browser_the_address_is_enough(store):
    words = ("-m", "taichi_nmm", "explore", store, "--port", 0)
    with serving(*words, env=os.environ | {"BROWSER": "no-such-program"}) as said:
        address = said.readline().split()[1]
        with urllib.request.urlopen(address, timeout=30) as answer:
            assert answer.status == 200
