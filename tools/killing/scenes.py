"""The commands that write, each small: what they need, and how they are called.

Each works in a folder of its own, which holds all that it writes.
"""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from study.cli import run_command
from study.comparison import compare
from study.features.survival import GROUNDS
from study.optimum import generations

STORE = """
samples = 32
shard_rows = 16
seed = 7
[simulation]
duration_s = 2.0
[families.up]
settings = 1
min_survival_s = 0.5
terrain = {kind = "ramp"}
"""
FAMILY = """
[families.{name}]
settings = 1
min_survival_s = 0.5
terrain = {{kind = "rough"}}
"""  # of each ground that the quickstart's best sampler asks for
REPERTOIRE = """
[repertoire]
evaluations = 300
settings = 1
candidates = 6
"""
EXPERIMENT = """
name = "{name}"
seed = 5
runs = {runs}
trials = 4
arms = ["random", "dog"]
[objective]
cost = "smooth"
[simulation]
duration_s = 2.0
[body]
disturbance = {disturbance}
[terrain]
kind = "{kind}"
[cmaes]
population = 4
max_generations = 3
[stores]
flat = "{base}/store"
diverse = "{base}/store"
"""
COMPARED = "compared"
LATE = ("ribs.archives", "optuna_dashboard")  # which commands import when they need them


@dataclass(frozen=True)
class Scene:
    """A command and its words, in which {base} is the folder of what it needs.

    Attributes:
        command: a file of study/commands.
        words: on its line.
        needs: folders of the base that it writes to, and so gets copies of.
        configs: in place of those that it always takes, by the names of its constants.
    """

    command: str
    words: tuple[str, ...]
    needs: tuple[str, ...] = ()
    configs: Mapping[str, str] = field(default_factory=dict)

    def line(self, base: Path) -> list[str]:
        """Its words."""
        return [word.format(base=base) for word in self.words]

    def run(self, base: Path) -> None:
        """The command, in this process; leaves with its exit code."""
        module = import_module(f"study.commands.{self.command}")
        sys.argv = [f"{self.command}.py", *self.line(base)]
        for name, config in self.configs.items():
            setattr(module, name, config.format(base=base))
        commit_often()
        run_command(module.main)

    def prepare(self, base: Path, folder: Path) -> None:
        """Make the folder that it works in."""
        folder.mkdir(parents=True)
        for name in self.needs:
            shutil.copytree(base / name, folder / name)


def commit_often() -> None:
    """Have what comes every twenty seconds come with every stretch of work."""
    compare.CHECKPOINT_S = compare.EXPORT_S = generations.CHECKPOINT_S = 0.0
    compare.STRETCH_TRIALS, generations.STRETCH_GENERATIONS = 2, 1


def scenes(pictures: bool) -> dict[str, Scene]:
    """All of them by their commands.

    Args:
        pictures: whether walks are drawn, too; a simulator that is replaced records none.
    """
    one = ("--workers", "1")
    rough = ("--config", "{base}/rough.toml")
    drawn = () if pictures else ("--no-artifacts",)
    studies = "sqlite:///out/studies.db"
    some = [
        Scene("precompute", ("--config", "{base}/bred.toml", "--out", "out", *one)),
        Scene("study", (*rough, "--arm", "dog", "--storage", studies, "--out", "out")),
        Scene("compare", (*rough, "--out", "out", *one, *drawn)),
        Scene("report", (COMPARED, *(() if pictures else ("--no-strips",))), (COMPARED,)),
        Scene("optimum", ("--config", "{base}/flat.toml", "--out", "out", *one)),
        Scene("draw_store", ("{base}/store", "--out", "store.png")),
    ]
    if pictures:
        configs = {"STORE_CONFIG": "{base}/grounds.toml", "CONFIG": "{base}/quick.toml"}
        walk = ("--out", "out", "--duration", "3", "--movie-seconds", "0.5", "--mjcf", "out.xml")
        some += [Scene("walk", walk), Scene("quickstart", ("--out", "out"), configs=configs)]
    return {scene.command: scene for scene in some}


def load(pictures: bool) -> None:
    """Import what the commands do, so that no process has to."""
    commands = [f"study.commands.{name}" for name in scenes(pictures)]
    for name in (*commands, *LATE, *(["taichi"] if pictures else [])):
        import_module(name)


def preparations(pictures: bool) -> list[Scene]:
    """What makes the base's store and comparison, run in it."""
    made = scenes(pictures)
    store = Scene(
        "precompute", ("--config", "{base}/store.toml", "--out", "store", "--workers", "1")
    )
    words = made["compare"].words
    return [store, Scene("compare", (*words, "--out", COMPARED, "--no-artifacts"))]


def write_configs(base: Path) -> None:
    """The configurations of all scenes."""
    base.mkdir(parents=True, exist_ok=True)
    (base / "store.toml").write_text(STORE)
    (base / "bred.toml").write_text(STORE + REPERTOIRE)
    others = [FAMILY.format(name=name) for name in GROUNDS if f"[families.{name}]" not in STORE]
    (base / "grounds.toml").write_text(STORE + "".join(others))
    for name, runs, kind, disturbance in (
        ("rough", 2, "rough", 0.15), ("flat", 2, "flat", 0.0), ("quick", 1, "rough", 0.15)
    ):  # fmt: skip
        text = EXPERIMENT.format(
            name=name, runs=runs, kind=kind, disturbance=disturbance, base=base
        )
        (base / f"{name}.toml").write_text(text)
