"""Input that cannot be used: one line that names it, exit code 2, and nothing written.

One table of commands, their words and the beginning of the line, in a folder with the files below.
"""

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, PUBLISHED_GAINS
from taichi_nmm.settings import Settings
from tests.study import fake_walker
from tests.tools.conftest import Tool

GAINS = dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True))
HUGE = 10**9
FAR = 2**40
ONE_OF = "cannot be used; allowed: "

FILES: dict[str, Any] = {
    "low-level.json": GAINS | {"theta_ref": 3.0}, "result.json": {"gains": GAINS | {"K_SOL": 99}},
    "missing.json": {name: value for name, value in GAINS.items() if name != "l_clr"},
    "brace.json": "{", "empty.toml": "", "bracket.toml": "[", "sead.toml": "samples = 5\nsead = 1",
    "sede.toml": "seed = 1\nsede = 1", "half.toml": "samples = ", "five.toml": "samples = 5",
    "file": "in the way",
}  # fmt: skip
BASE = {
    "compare": "--config rough8-smooth --out new",
    "study": "--config rough8-smooth --arm random --storage sqlite:///new.db --out new",
    "precompute": "--config five.toml --out new --workers 1", "walk": "--config flat --out new",
    "walk of published": "--gains published --config flat --out new",
    "compare_outside": "--out new --cache new",
}  # fmt: skip
PLACES = [("row: 1", "--row 1 --store store"), ("trial: 'a/b/0'", "--trial a/b/0 --storage .")]

REFUSED: list[tuple[str, str, str]] = [
    *(("compare", words, line) for words, line in [
        (f"--runs {HUGE}", f"runs: {HUGE} {ONE_OF}a whole number from 1 to 10000"),
        (f"--trials {HUGE}", f"trials: {HUGE}"), (f"--workers {HUGE}", f"workers: {HUGE}"),
        (f"--seed {2**63}", f"seed: {2**63}"), (f"--runs {'9' * 5000}", "runs: '999"),
        ("--runs 1.5", f"runs: '1.5' {ONE_OF}a whole"), ("--arms dog,cat", "arm: 'cat'"),
        ("--rums 1", "unrecognized arguments: --rums 1"),
        ("--arms random --storage oracle://host/db", "storage: '***'"),
        ("--arms random --storage foo", "storage: "), ("--runs 0", "runs: 0"),
        ("--config nowhere.toml", "config: 'nowhere.toml'"),
    ]),
    ("compare of nothing", "", "the following arguments are required: --config"),
    *((name, words, line) for name in ("compare", "study") for words, line in [
        ("--trials 0", "trials: 0"), ("--seed -1", "seed: -1"),
    ]),
    *(("precompute", f"--{name} {value}", f"{name}: {value}") for name, value in [
        ("samples", FAR), ("samples", 0), ("workers", 0), ("workers", -1),
    ]),
    ("precompute", "--out /dev/null/store", "out: "),
    *(("precompute", f"--config {name}.toml", line) for name, line in [
        ("sead", f"sead: 1 {ONE_OF}"), ("half", "config: "), ("nowhere", "config: "),
    ]),
    *(("study", words, line) for words, line in [
        (f"--trials {HUGE}", f"trials: {HUGE}"), (f"--run {HUGE}", f"run: {HUGE}"),
        ("--run 50", f"run: 50 {ONE_OF}0 to 49, the runs of rough8-smooth"),
        ("--run -1", "run: -1"), ("--config nowhere.toml", "config: 'nowhere.toml'"),
        ("--arm cat", f"arm: 'cat' {ONE_OF}one of random, "),
        ("--store store", "... arms that read one store; random: none"),
        ("--arm dog --store nowhere", "... nowhere"),
        ("--arm dog --store store --trials 21", f"trials: 21 {ONE_OF}at most 20"),
    ]),
    *(("study", f"--storage postgresql{url}", f"storage: '{shown}' {ONE_OF}") for url, shown in [
        ("://host/db", "***"), ("+psycopg://me:secret@host", "postgresql+psycopg://***@host"),
        ("+psycopg://me:secret@127.0.0.1:1/walker", "postgresql+psycopg://***@127.0.0.1:1/walker"),
    ]),
    *(("validate", words, line) for words, line in [
        (f"--samples {FAR}", f"samples: {FAR}"), (f"--draws {HUGE}", f"draws: {HUGE}"),
        ("--samples 99", f"samples: 99 {ONE_OF}a whole number from 100"), ("--seed -1", "seed: -1"),
    ]),
    ("validate_mujoco", f"--samples {FAR}", f"samples: {FAR}"),
    *(("bench", words, line) for words, line in [
        (f"--samples {FAR}", f"samples: {FAR}"), ("--samples 0", "samples: 0"),
        ("--lanes 1,65", "lanes: '1,65'"), ("--against .", "against: "),
    ]),
    *(("time_sampler", words, line) for words, line in [
        (f"--rows {FAR}", f"rows: {FAR}"), ("--rows 500", f"rows: 500 {ONE_OF}a whole number"),
        ("--repeats 0", "repeats: 0"),
    ]),
    *(("compare_outside", words, line) for words, line in [
        ("--arms random,cat", f"arms: 'cat' {ONE_OF}"), ("--problems easy", "problems: 'easy'"),
        ("--trials 1", "trials: 1"), ("--seeds 0", "seeds: 0"), (f"--seeds {HUGE}", "seeds: "),
    ]),
    *((name, words, line) for name in ("precompute", "compare") for words, line in [
        ("--cluster nowhere", f"cluster: 'nowhere' {ONE_OF}local:N"),
        ("--mixed", f"mixed: True {ONE_OF}only beside --cluster"),
    ]),
    ("walk", "--seed -1", "seed: -1"),
    ("walk", "--gains nobody.json", f"gains: 'nobody.json' {ONE_OF}one of published, reference"),
    *(("walk", f"--gains {name}.json", line) for name, line in [
        ("result", f"gains.K_SOL: 99 {ONE_OF}0 to 24"), ("brace", "... JSON object"),
        ("low-level", f"gains.theta_ref: 3.0 {ONE_OF}-0.174533 to 0.523599"),
        ("missing", "gains.l_clr: None"),
    ]),
    *(("walk of published", f"--duration={value}", "duration: ")
      for value in ("0", "-1", "nan", "1e9")),
    ("walk of published", "--movie-seconds=-1", "movie-seconds: -1.0"),
    *(("walk of published", f"--config {name}.toml", line) for name, line in [
        ("empty", "seed: 'missing'"), ("sede", "sede: 1"), ("bracket", "... a readable TOML file"),
    ]),
    *(("walk of published", f"--config rough8 --run={run}",
       f"run: {run} {ONE_OF}0 to 49, the runs of rough8") for run in (50, -1)),
    *(("walk of published", words, f"{field} {ONE_OF}none beside --gains")
      for field, words in PLACES),
    ("walk", " ".join(words for _, words in PLACES), "... none beside --row"),
    *(("walk", words, f"{field}: None {ONE_OF}a value: ") for words, field in [
        ("--row 1", "store"), ("--store out/store", "row"),
        ("--trial a/b/0", "storage"), ("--storage sqlite:///a.db", "trial"),
    ]),
    *(("walk", f"--row={row} --store store", f"row: {row} {ONE_OF}0 to 19, the rows of")
      for row in (20, -1, 10**30)),
    *(("walk", f"--row 1 --store {store}", line) for store, line in [
        ("nowhere", "... nowhere"), (".", "... a finished"),
    ]),
    ("walk of published", "--out file/below", "out: "),
    *(("walk of published", f"--mjcf {path}", f"mjcf: '{path}'")
      for path in ("file/walker.xml", "nowhere/walker.xml", ".")),
    ("walk of published", "--engine mujoco --arch cuda", "simulation.arch: 'cuda'"),
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files, and a store of 20 rows."""
    folder = tmp_path_factory.mktemp("refusals")
    for name, content in FILES.items():
        (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    fake_walker.write_plain_store(folder / "store", 20)
    return folder


@pytest.fixture
def untouched(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, in which nothing may be written."""
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    yield folder
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def words_of(name: str, words: str) -> list[str]:
    return [name.partition(" of ")[0], *shlex.split(BASE.get(name, "")), *shlex.split(words)]


@pytest.mark.parametrize(
    ("name", "words", "line"),
    [pytest.param(*case, id=f"{case[0]} {case[1][:40]}") for case in REFUSED],
)
def test_refused_in_one_line(name: str, words: str, line: str, untouched: Path, tool: Tool) -> None:
    anywhere = ".*" if line.startswith("... ") else ""
    tool.refuses(anywhere + re.escape(line.removeprefix("... ")), *words_of(name, words))
    assert "secret" not in tool.err


def no_gpu(settings: Settings) -> None:
    raise InputError("simulation.arch", settings.arch, "an architecture of this machine")


@pytest.mark.parametrize(("patched", "value", "name", "words", "line"), [
    *(("taichi_nmm.kernel.backend", SimpleNamespace(start=no_gpu), name, "--arch cuda",
       "simulation.arch: 'cuda'") for name in ("compare", "precompute", "study")),
    *(("taichi_nmm.mujoco_engine.find_spec", lambda name: None, "walk of published", words,
       r".*pip install 'taichi-nmm\[mujoco\]'") for words in ("--engine mujoco", "--mjcf x")),
])  # fmt: skip
def test_what_a_machine_lacks_is_said(
    patched: str, value: object, name: str, words: str, line: str,
    untouched: Path, tool: Tool, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(patched, value, raising=False)
    tool.refuses(line, *words_of(name, words))


def test_without_ffmpeg(untouched: Path, tool: Tool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    for name, words in (
        ("walk of published", ""),
        ("compare", "--arms random --runs 1 --trials 1"),
    ):
        tool.refuses("ffmpeg: .*allowed: a working ffmpeg", *words_of(name, words))
