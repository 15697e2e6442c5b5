"""Commands of a bench, killed at random moments: nothing is lost, and nothing is entered twice.

    python -m tests.study.bench.kills --kills 200 --seed 1

An operator whose command is killed looks at the entries, and repeats it if it has made none. In the
end they are those of a bench whose commands were left alone, and the study shown follows from them.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from study.bench.bench import Bench, frozen
from tests.study.bench import robot
from tests.tools.running import ROOT

LONGEST_S = 2.5  # of a command, on a slow machine
ROUND = (
    "next", "record {0} --cost 0.9 --torque 81", "next --batch 2", "fail {1} --seconds 2.1",
    "abort {2}", "record {2} --cost 3.1", "correct {2} --cost 0.31", "undo",
    "correct {2} --cost 0.41", "add --gains mine.json --cost 0.6", "context ground-{3}",
)  # fmt: skip


def lines(rounds: int) -> list[list[str]]:
    """The commands, each of which makes an entry; a round has four trials."""
    numbers = ([str(4 * r + n) for n in range(4)] for r in range(rounds))
    told = [line.format(*four).split() for four in numbers for line in ROUND]
    return [["new", "walk.toml"], *told]


def run(folder: Path, words: list[str], kill_after_s: float | None) -> bool:
    """Run a command; whether it was killed."""
    command = [sys.executable, "-m", "taichi_nmm", "bench", *words, "--operator", "me"]
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(folder)}
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=quiet) as process:
        try:
            code = process.wait(kill_after_s)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait() == -signal.SIGKILL
    assert code == 0, words
    return False


def entries(folder: Path) -> list[Any]:
    """What was entered, without times."""
    if not (folder / "walk.db").exists():
        return []
    found = Bench(folder / "walk.toml").entries
    return [(one.number, one.kind, one.operator, json.dumps(one.data)) for one in found]


def campaign(folder: Path, rounds: int, kills: int, rng: np.random.Generator) -> int:
    """Run all commands, killed until so many kills; how many there were."""
    robot.write(folder)
    (folder / "mine.json").write_text(json.dumps({"stiffness": 150.0, "damping": 1.0}))
    killed = 0
    for words in lines(rounds):
        before = len(entries(folder))
        while len(entries(folder)) == before:
            after_s = float(rng.uniform(0.0, LONGEST_S)) if killed < kills else None
            killed += run(folder, words, after_s)
        assert len(entries(folder)) == before + 1, words
    return killed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with tempfile.TemporaryDirectory() as name:
        disturbed, quiet = Path(name, "disturbed"), Path(name, "quiet")
        told, began_s = [], time.monotonic()
        for folder, kills in ((disturbed, args.kills), (quiet, 0)):
            folder.mkdir()
            killed = campaign(folder, args.rounds, kills, np.random.default_rng(args.seed))
            told.append(entries(folder))
            print(f"{folder.name}: {killed} kills, {len(told[-1])} entries,"
                  f" {time.monotonic() - began_s:.0f} s", flush=True)  # fmt: skip
        assert told[0] == told[1]
        bench = Bench(disturbed / "walk.toml")
        shown = bench.shown().get_trials()
        wanted = [frozen(t, bench.space, bench.plan) for t in bench.state.trials.values()]
        assert [(t.value, t.params, t.state) for t in shown] == [
            (t.value, t.params, t.state) for t in wanted
        ]
    print("the same entries, and the study shown follows from them")


if __name__ == "__main__":
    main()
