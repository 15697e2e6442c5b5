"""The commands on a cluster of this machine: the same bytes, also when a folder changes sides."""

import os
import shutil
import signal

import pytest

from tests.cases import ASSETS
from tests.processes import until
from tests.tools.running import INTERRUPTED, WAIT_S, finish, run_tool, start

pytest.importorskip(
    "distributed", reason="distributed is not installed: the extra cluster"
)
pytestmark = pytest.mark.slow

CONFIGURATIONS = ASSETS / "cluster"
HERE, THERE = "--workers 1", "--cluster local:2"


def run(folder, line, code=0):
    """A command in this process, which compiles the walker once for all of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run_tool(patch, *line.split()) == code


def tables(folder):
    files = [
        file for file in sorted(folder.rglob("*.parquet")) if file.parent.name != "arms"
    ]
    kept = [file for file in files if file.name != "proposal_times.parquet"]
    return {str(file.relative_to(folder)): file.read_bytes() for file in kept}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a store, made here."""
    path = tmp_path_factory.mktemp("cluster")
    shutil.copy(CONFIGURATIONS / "store.toml", path)
    run(path, f"precompute --config store.toml --out store {HERE}")
    return path


def test_a_store_is_the_same_and_goes_on_on_either_side(folder):
    """All of it is made there by the test of --fresh below."""
    shutil.copytree(folder / "store", folder / "both")
    for where in (THERE, HERE):
        for number in (0, 3, 7):
            (folder / "both" / f"part-{number:05d}.parquet").unlink()
        run(folder, f"precompute --config store.toml --out both {where}")
        assert tables(folder / "both") == tables(folder / "store")


@pytest.mark.parametrize(
    "engine", ["taichi", pytest.param("mujoco", marks=pytest.mark.campaign)]
)
def test_a_comparison_that_was_begun_here_goes_on_there(folder, engine):
    """Its store travels."""
    known = (CONFIGURATIONS / "taichi.toml").read_text()
    config = folder / f"{engine}.toml"
    config.write_text(known.replace('engine = "taichi"', f'engine = "{engine}"'))
    compare = f"compare --config {engine}.toml --out {engine}"
    run(folder, f"{compare}-here {HERE}")
    expected = tables(folder / f"{engine}-here")
    assert list(expected) == ["trials.parquet"]
    run(folder, f"{compare}-both {HERE} --trials 2")
    run(folder, f"{compare}-both --cluster local:1")
    assert tables(folder / f"{engine}-both") == expected


def test_a_folder_of_another_kind_is_refused_unless_it_begins_anew(folder, capfd):
    line = "precompute --config store.toml --out other --cluster local:1"
    shutil.copytree(folder / "store", folder / "other")
    (folder / "other" / "kind.json").write_text('{"canary": "abc"}')
    capfd.readouterr()
    run(folder, line, code=2)
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "gets no work: canary " in lines[0] and lines[1].startswith(
        "error: cluster: 'local:1'"
    )
    run(folder, f"{line} --fresh")
    assert tables(folder / "other") == tables(folder / "store")
    assert '"canary": "abc"' not in (folder / "other" / "kind.json").read_text()


def test_ctrl_c_is_one_line_and_what_is_done_is_kept(folder):
    line = (
        "precompute --config store.toml --samples 4000 --out stopped --cluster local:1"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        process = start(*line.split(), program=("-m", "taichi_nmm"))
    stopped = folder / "stopped"
    until(lambda: len(list(stopped.glob("part-*"))) >= 3, WAIT_S)
    os.killpg(process.pid, signal.SIGINT)
    done = finish(process)
    assert (done.code, done.last) == (130, INTERRUPTED)
    assert "Traceback" not in done.error
    assert 3 <= len(list(stopped.glob("part-*"))) < 500
