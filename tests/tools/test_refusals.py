"""Input that cannot be used: one line that names it, exit code 2, and nothing written."""

import json
import re
import shlex
from types import SimpleNamespace

import pytest

from taichi_nmm import GAIN_NAMES, PUBLISHED_GAINS, InputError
from tests.cases import asset
from tests.study import fake_walker

GAINS = dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True))

# Commands, their words and the beginning of the line; they are run in a folder with the
# files.
REFUSED = asset("refusals.toml")
BASE, TEXTS = REFUSED.pop("base"), REFUSED.pop("files")
FILES = TEXTS | {
    "low-level.json": GAINS | {"theta_ref": 3.0},
    "result.json": {"gains": GAINS | {"K_SOL": 99}},
    "missing.json": {name: value for name, value in GAINS.items() if name != "l_clr"},
}
REFUSED["compare"][f"--runs {'9' * 5000}"] = "runs: '999"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the files, and a store of 20 rows."""
    folder = tmp_path_factory.mktemp("refusals")
    for name, content in FILES.items():
        (folder / name).write_text(
            content if isinstance(content, str) else json.dumps(content)
        )
    fake_walker.write_plain_store(folder / "store", 20)
    return folder


@pytest.fixture
def untouched(folder, monkeypatch):
    """The current folder, in which nothing may be written."""
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    yield folder
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def words_of(name, words):
    return [
        name.partition(" of ")[0],
        *shlex.split(BASE.get(name, "")),
        *shlex.split(words),
    ]


@pytest.mark.parametrize(
    ("name", "words", "line"),
    [
        pytest.param(name, words, line, id=f"{name} {words[:40]}")
        for name, lines in REFUSED.items()
        for words, line in lines.items()
    ],
)
def test_refused_in_one_line(name, words, line, untouched, tool):
    anywhere = ".*" if line.startswith("... ") else ""
    tool.refuses(
        anywhere + re.escape(line.removeprefix("... ")), *words_of(name, words)
    )
    assert "secret" not in tool.err


def no_gpu(settings):
    raise InputError(
        "simulation.arch", settings.arch, "an architecture of this machine"
    )


@pytest.mark.parametrize(
    ("patched", "value", "name", "words", "line"),
    [
        *(
            (
                "taichi_nmm.kernel.backend",
                SimpleNamespace(start=no_gpu),
                name,
                "--arch cuda",
                "simulation.arch: 'cuda'",
            )
            for name in ("compare", "precompute", "study")
        ),
        *(
            (
                "taichi_nmm.mujoco_engine.find_spec",
                lambda name: None,
                "walk of published",
                words,
                r".*pip install 'taichi-nmm\[mujoco\]'",
            )
            for words in ("--engine mujoco", "--mjcf x")
        ),
    ],
)
def test_what_a_machine_lacks_is_said(
    patched, value, name, words, line, untouched, tool, monkeypatch
):
    monkeypatch.setattr(patched, value, raising=False)
    tool.refuses(line, *words_of(name, words))


def test_without_ffmpeg(untouched, tool, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    tool.refuses(
        "ffmpeg: .*allowed: a working ffmpeg", *words_of("walk of published", "")
    )
