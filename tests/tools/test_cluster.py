"""The commands on a cluster of this machine: the same bytes, also when a folder changes sides."""

import os
import shutil
import signal
from functools import partial
from pathlib import Path
from subprocess import Popen

import pytest

from tests.cases import ASSETS
from tests.processes import until
from tests.tools.running import INTERRUPTED, ROOT, WAIT_S, finish, run_tool, start

pytest.importorskip(
    "distributed", reason="distributed is not installed: the extra cluster"
)
pytestmark = pytest.mark.slow

CONFIGURATIONS = ASSETS / "cluster"
THERE = ("--cluster", "local:2")


def begin(folder: Path, *words: object) -> "Popen[str]":
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("PYTHONPATH", str(ROOT))
        return start(*words, program=("-m", "taichi_nmm"))


def run(folder: Path, *words: object, code: int = 0) -> str:
    """What a command prints on standard error, which ends with this code."""
    done = finish(begin(folder, *words))
    assert done.code == code, done.error
    return done.error


def run_here(folder: Path, *words: object) -> None:
    """A command in this process, which compiles the walker once for all of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run_tool(patch, *words, "--workers", 1) == 0


def tables(folder: Path) -> dict[str, bytes]:
    files = [
        file for file in sorted(folder.rglob("*.parquet")) if file.parent.name != "arms"
    ]
    kept = [file for file in files if file.name != "proposal_times.parquet"]
    return {str(file.relative_to(folder)): file.read_bytes() for file in kept}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a store, made here."""
    path = tmp_path_factory.mktemp("cluster")
    shutil.copy(CONFIGURATIONS / "store.toml", path)
    run_here(path, "precompute", "--config", "store.toml", "--out", "store")
    return path


def test_a_store_is_the_same_and_goes_on_on_either_side(folder: Path) -> None:
    """All of it is made there by the test of --fresh below."""
    words = ("precompute", "--config", "store.toml", "--out", "both")
    shutil.copytree(folder / "store", folder / "both")
    for go_on in (
        partial(run, folder, *words, *THERE),
        partial(run_here, folder, *words),
    ):
        for number in (0, 3, 7):
            (folder / "both" / f"part-{number:05d}.parquet").unlink()
        go_on()
        assert tables(folder / "both") == tables(folder / "store")


@pytest.mark.parametrize(
    "engine", ["taichi", pytest.param("mujoco", marks=pytest.mark.campaign)]
)
def test_a_comparison_that_was_begun_here_goes_on_there(
    folder: Path, engine: str
) -> None:
    """Its store travels."""
    config, known = (
        folder / f"{engine}.toml",
        (CONFIGURATIONS / "taichi.toml").read_text(),
    )
    config.write_text(known.replace('engine = "taichi"', f'engine = "{engine}"'))
    words = ("compare", "--config", config, "--out")
    run_here(folder, *words, f"{engine}-here")
    expected = tables(folder / f"{engine}-here")
    assert list(expected) == ["trials.parquet"]
    run_here(folder, *words, f"{engine}-both", "--trials", "2")
    run(folder, *words, f"{engine}-both", "--cluster", "local:1")
    assert tables(folder / f"{engine}-both") == expected


def test_a_folder_of_another_kind_is_refused_unless_it_begins_anew(
    folder: Path,
) -> None:
    words = (
        "precompute",
        "--config",
        "store.toml",
        "--out",
        "other",
        "--cluster",
        "local:1",
    )
    shutil.copytree(folder / "store", folder / "other")
    (folder / "other" / "kind.json").write_text('{"canary": "abc"}')
    lines = run(folder, *words, code=2).splitlines()
    assert len(lines) == 2
    assert "gets no work: canary " in lines[0] and lines[1].startswith(
        "error: cluster: 'local:1'"
    )
    run(folder, *words, "--fresh")
    assert tables(folder / "other") == tables(folder / "store")
    assert '"canary": "abc"' not in (folder / "other" / "kind.json").read_text()


def test_ctrl_c_is_one_line_and_what_is_done_is_kept(folder: Path) -> None:
    words = (
        "precompute",
        "--config",
        "store.toml",
        "--samples",
        4000,
        "--out",
        "stopped",
    )
    process = begin(folder, *words, *THERE)
    stopped = folder / "stopped"
    until(
        lambda: process.poll() is not None or len(list(stopped.glob("part-*"))) >= 3,
        WAIT_S,
    )
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)
    done = finish(process)
    assert (done.code, done.last) == (
        130,
        INTERRUPTED,
    ) and "Traceback" not in done.error
    assert 3 <= len(list(stopped.glob("part-*"))) < 500
