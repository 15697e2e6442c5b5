"""taichi-nmm explore: what it refuses, in one line."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

import taichi_nmm
from tests.study import fake_walker
from tests.tools.running import load_command, run_tool

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("bokeh", reason="no bokeh: pip install 'taichi-nmm[explore]'")
    path = tmp_path_factory.mktemp("made") / "store"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        fake_walker.write_plain_store(path)
    return path


def refused(
    patch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object
) -> str:
    assert run_tool(patch, "explore", *arguments, "--no-browser") == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1
    return said


def test_neither_store_nor_comparison(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("no store")
    for name in ("nowhere", "empty"):
        said = refused(monkeypatch, capsys, tmp_path / name)
        assert "the folder of a store or of a comparison" in said
    assert "error: store: " in refused(monkeypatch, capsys, tmp_path / "file")
    (tmp_path / "compared").mkdir()
    (tmp_path / "compared" / "experiment.json").write_text("[]")
    assert "with trials" in refused(monkeypatch, capsys, tmp_path / "compared")


def test_a_store_of_another_version(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(store, tmp_path / "copy")
    document = json.loads((copy / "manifest.json").read_text())
    document["format"] = 99
    (copy / "manifest.json").write_text(json.dumps(document))
    assert "of format 99" in refused(monkeypatch, capsys, copy)


def test_without_bokeh_its_name_is_said(
    store: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith("study.explore")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    said = refused(monkeypatch, capsys, store)
    assert "package: 'bokeh' is not installed" in said


def test_a_browser_of_a_terminal_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    explore = load_command("explore")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in explore.DISPLAYS:
        monkeypatch.setenv(name, "")
    assert not explore.has_display()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert explore.has_display()


def test_without_a_browser_the_address_is_enough(store: Path) -> None:
    command = [sys.executable, "-m", "taichi_nmm", "explore", store, "--port", "0"]
    environment = os.environ | {"BROWSER": "no-such-program"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        address = process.stdout.readline().split()[1]
        with urllib.request.urlopen(address, timeout=30) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_a_port_in_use(
    store: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = refused(monkeypatch, capsys, store, "--port", port)
    assert f"error: port: {port} cannot be used; allowed: a free port" in said
