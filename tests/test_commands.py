"""The commands together: every one that a document names, and one study through all of them."""

import json
import re
import shlex
from functools import partial
from itertools import pairwise
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage.store import open_store
from study import pictures
from study.commands import quickstart
from study.experiment import artifacts
from study.experiment import sweep as sweeping
from study.experiment.gains import gains_at
from study.experiment.sweep import points_of
from study.experiment.walker import read_experiment
from study.explore import walk as walking
from study.explore.trials import open_rows
from study.options import config_path, shipped_configs
from study.pictures import trajectory_files
from taichi_nmm.parameters import DEVICE, GAIN_NAMES
from tests.cases import ASSETS
from tests.study import fake_walker
from tests.test_docs import code_blocks
from tests.tools.conftest import tool
from tests.tools.running import ROOT, run_tool

CONFIGS = {*shipped_configs(stores=True), *shipped_configs(stores=False)}
PAINTERS = ("write_strip", "write_gait_cycle", "write_movies")

__all__ = ["tool"]  # a fixture of the commands' own tests
# Options that make a command short, at its end, where they replace earlier ones.
SHORT = {
    "precompute": "--samples 24 --workers 1",
    "study": "--trials 2",
    "quickstart": "",
    "compare": "--runs 1 --trials 2 --workers 1",
    "sweep": "--runs 1 --trials 2 --workers 1",
    "walk": "--duration 2 --movie-seconds 0.3",
}

# Files that a document has the reader make: taken from the explorer's page, or copied
# and changed.
GAINS = dict(zip(GAIN_NAMES, taichi_nmm.PUBLISHED_GAINS.tolist(), strict=True))
OWN = ROOT / "docs" / "own-simulator.md"
TAKEN_AWAY = {
    "my_robot.py": code_blocks(OWN)[0],
    "pole.toml": code_blocks(OWN, "toml")[0],
    "gains.json": json.dumps(GAINS),
    "walk.toml": 'seed = 1\n[terrain]\nkind = "rough"\n',
    "short.toml": (ROOT / "configs" / "store.toml").read_text(),
}


def named_commands():
    """Every command line of `SHORT` that a document or a comment shows: tool, arguments."""
    documents = [
        ROOT / "README.md",
        ROOT / "Makefile",
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "configs").glob("*.toml"),
        *(ROOT / "tools").glob("*.py"),
        *(ROOT / "study" / "commands").glob("*.py"),
    ]
    arguments = r"([^`#\n\\]*(?:\\*\n\s*--[^`#\n\\]*)*)"
    line = (
        rf"(?:python tools/(?=\w+\.py)|taichi-nmm (?=\w+ -))(\w+)(?:\.py\b)?{arguments}"
    )
    found = set()
    for document in documents:
        for command, arguments in re.findall(line, document.read_text()):
            words = shlex.split(
                arguments.replace("\\", " ").replace("URL", "sqlite:///studies.db")
            )
            if "--cluster" in words:  # whose processes would run the real simulator
                place = words.index("--cluster")
                words = [*words[:place], *words[place + 2 :]]
            # placeholders: names stand elsewhere too
            if not {"$@", "$*", "NAME"} & set(words):
                found.add((command, *words))
    return sorted(words for words in found if words[0] in SHORT)


def run_of(words):
    """What a command line runs here: its options in any order, without those that are replaced."""
    options = re.findall(r"--([\w-]+)((?: (?!--)\S+)*)", " ".join(words[1:]))
    replaced = re.findall(r"--([\w-]+)", f"{SHORT[words[0]]} --out")
    return words[0], *sorted(each for each in options if each[0] not in replaced)


COMMANDS = named_commands()
# Of lines that run the same here the longest: its options are read, too.
DIFFERENT = {run_of(words): words for words in sorted(COMMANDS, key=len)}
TAKEN = [  # other contacts of MuJoCo differ in numbers; the quickstart has a test of its own
    pytest.param(
        words,
        id=" ".join(words),
        marks=[pytest.mark.campaign]
        if re.search(r"mujoco-.*-(middle|hard)", str(words))
        else [],
    )
    for words in sorted(DIFFERENT.values())
    if words != ("quickstart",)
    and "robots.toml" not in words  # tests of documents run its page
]


def configurations(words):
    """Configurations that a command line names; the quickstart reads two by itself."""
    given = {other for word, other in pairwise(words) if word == "--config"}
    if words[0] == "quickstart":
        given = {quickstart.CONFIG, quickstart.STORE_CONFIG}
    return {config_path(name).stem for name in given}


def test_every_configuration_is_named_by_a_command():
    pairs = {
        (words[0], config) for words in COMMANDS for config in configurations(words)
    }
    assert {tool for tool, _ in pairs} == set(SHORT)
    assert {config for _, config in pairs} - {"walk", "pole", "robots"} == CONFIGS
    assert len(pairs) > len(CONFIGS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with all that named commands read: stores, and comparisons to draw from."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        (folder / "configs").symlink_to(ROOT / "configs")
        for name, text in TAKEN_AWAY.items():
            (folder / name).write_text(text)
        out = folder / "out"
        fake_walker.write_store(out / "store")
        for kind in ("worlds", "worlds-large", "stairs", "prosthesis"):
            (out / f"store-{kind}").symlink_to(out / "store")
        fake_walker.write_store(
            out / "store-worlds-steps", kept=["step_length_sd_m", "step_duration_sd_s"]
        )
        fake_walker.write_store(
            out / "store-speed", kept=["human_deviation", "step_duration_mean_s"]
        )
        device = [each.name for each in DEVICE]
        fake_walker.write_store(
            out / "store-exo", searched=device, fixed_gains="reference"
        )
        (out / "store-exo-hip").symlink_to(out / "store-exo")
        kept = {
            "searched": device,
            "fixed_gains": "reference",
            "kept": ["activation_cubed_mean"],
        }
        fake_walker.write_store(out / "store-exo-effort", **kept)
        for line in (
            "precompute --config walker2d --samples 32",
            "precompute --config ant --samples 32",
            "compare --config rough8-smooth --arms dog --runs 8 --trials 13",
            "compare --config outside-limp --arms worlds --runs 1 --trials 35",
            "compare --config mujoco-rough8-soft --arms worlds --runs 1 --trials 1",
        ):
            assert run_tool(patch, *line.split(), "--workers", 1) == 0
        for robot in ("ant", "walker2d"):
            for kind in ("one-world", "four-worlds", "few-rows"):
                (out / f"{robot}-{kind}").symlink_to(out / robot)
    return folder


@pytest.fixture
def no_painters(monkeypatch):
    for name in PAINTERS:
        for module in (pictures, artifacts):  # which has imported them from the first
            is_first = module is pictures
            monkeypatch.setattr(module, name, lambda path, *_: path, raising=is_first)
    monkeypatch.setattr("study.pictures.strip.strips_figure", lambda *_: None)
    monkeypatch.setattr("study.pictures.strip.gallery_figure", lambda *_: None)
    monkeypatch.setattr("study.pictures.style.save_png", lambda _, path: path)
    monkeypatch.setattr(trajectory_files, "write_trajectory", lambda *_: None)


@pytest.mark.slow
@pytest.mark.parametrize("words", TAKEN)
def test_a_command_that_is_named_is_taken(
    made, words, tmp_path, no_painters, monkeypatch
):
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    # 20, and not 520, generations; and the speeds of fakes are much alike.
    monkeypatch.setattr("storage.specification.Repertoire.generations", 20)
    monkeypatch.setattr("study.experiment.gains.SPEED_TOLERANCE_MPS", 1.0)
    # All points of a sweep are read, and the last two run.
    monkeypatch.setattr(sweeping, "points_of", lambda *given: points_of(*given)[-2:])
    monkeypatch.chdir(tmp_path)
    for name in ("configs", "out", *TAKEN_AWAY):
        (tmp_path / name).symlink_to(made / name)
    only_prints = "--front" in words
    more = "" if only_prints else f"{SHORT[words[0]]} --out made"
    assert run_tool(monkeypatch, *words, *more.split()) == 0
    assert (tmp_path / "made").is_dir() is not only_prints


# On the real simulator: a store, a comparison of it, and its trials one by one.

ARMS = ("dog", "cmaes-cold", "cmaes-warm")
TRIALS = 4


SEARCHED = ("theta_ref", "exo_torque", "K_SOL_asymmetry")
GOAL = """cost = "weighted"
fell_cost = 50.0
[objective.terms]
cost_of_transport_jpkgpm = 1.0
human_deviation = 0.5
mean_speed_mps = {weight = 9.0, target = 1.2}"""
OWN_WALKER = (ASSETS / "own-walker.toml").read_text()


OF_A_WALK = (
    "duration_s",
    "distance_m",
    "mean_speed_mps",
    "phi_printed",
    "end_reason",
)


class Real:
    """A folder with a small store, a comparison on it, and a database of the same studies live.

    All are of a walker with a body, muscles, a prosthesis, a device and a goal of its
    own.
    """

    def __init__(self, folder):
        self.store = folder / "store"
        rough8, store = (
            (ROOT / f"configs/{n}.toml").read_text() for n in ("rough8", "store")
        )
        searched = f"searched = {json.dumps(SEARCHED)}\n"
        store = f'kept = ["human_deviation"]\n{searched}{store}{OWN_WALKER}'
        (folder / "store.toml").write_text(store)
        text = searched + rough8.replace('cost = "smooth"', GOAL) + OWN_WALKER
        text = re.sub(r"duration_s = .*", "duration_s = 5.0", text)
        text = re.sub(r'"out/store[\w-]*"', f'"{self.store}"', text)
        (folder / "rough8.toml").write_text(text)
        self.config = folder / "rough8-smooth.toml"
        self.compared = folder / "compared"
        self.url = f"sqlite:///{folder / 'live.db'}"


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    real = Real(folder := tmp_path_factory.mktemp("real"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        config = f"--config rough8-smooth.toml --trials {TRIALS}"
        studies = f"study {config} --run 1 --storage {real.url} --out live --arm"
        for line in (
            "precompute --config store.toml --samples 300 --workers 1 --out store",
            f"compare {config} --arms {','.join(ARMS)} --runs 2 --workers 1 --out compared",
            *(f"{studies} {arm}" for arm in ARMS),
        ):
            assert run_tool(patch, *line.split()) == 0
    return real


@pytest.fixture
def walk(tmp_path, no_painters, tool):
    return partial(tool.json, "walk", "--out", tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
def test_a_trial_walks_as_it_did(real, walk, arm, tmp_path):
    """From the comparison's folder and database, the live study's, and the result of a walk."""
    own = f"--config {real.config} --run 1"
    where = f"{own} --trial rough8-smooth/{arm}/run-001/2".split()
    of_folder = walk(*where, "--storage", real.compared)
    rows = pq.read_table(real.compared / "trials.parquet").to_pylist()
    (row,) = (
        row for row in rows if (row["arm"], row["run"], row["trial"]) == (arm, 1, 2)
    )
    for name in OF_A_WALK:
        assert of_folder[name] == row[name], name
    assert of_folder["gains"] == {name: row[name] for name in (*GAIN_NAMES, *SEARCHED)}
    for file in (real.compared / "experiment.json", real.store / "specification.json"):
        known = json.loads(file.read_text())
        mass = known["body"]["mass"]
        assert mass["shank_left"] == mass["shank_right"] == 1.1
        assert known["world"]["muscles"] == {"SOL_left": 0.9}
        assert known["world"]["prosthesis"]["stiffness_nmprad"] == 350.0
        assert known["world"]["exoskeleton"]["motion"] == "hip_extension"
    paid = row["cost_of_transport_jpkgpm"] + 9.0 * abs(row["mean_speed_mps"] - 1.2)
    paid += 0.5 * (of_folder["human_deviation"] or 0.0)  # unknown of who made no step
    lasted = row["survived_fraction"]
    assert row["cost"] == pytest.approx(
        paid if lasted >= 1.0 else 50.0 * (2.0 - lasted)
    )
    best = real.store.with_name("live") / f"{arm}-run-001-best.json"
    assert set(json.loads(best.read_text())) == {*GAIN_NAMES, *SEARCHED}
    tried = [each for each in rows if (each["arm"], each["run"]) == (arm, 1)]
    cheapest = min(tried, key=lambda each: float(each["cost"]))
    again = walk(*own.split(), "--gains", best)
    assert again["distance_m"] == cheapest["distance_m"]
    for url in (f"sqlite:///{real.compared / 'studies.db'}", real.url):
        assert walk(*where, "--storage", url) == of_folder
    (tmp_path / "result.json").write_text(json.dumps(of_folder))
    assert walk(*own.split(), "--gains", tmp_path / "result.json") == of_folder


@pytest.mark.slow
def test_a_row_of_a_store_walks_as_it_did(real, walk):
    table = open_store(real.store).table()
    row = max(range(300), key=lambda row: float(table["phi_printed"][row].as_py()))
    level = real.store.with_name("level.toml")
    level.write_text(f"seed = 1\n{OWN_WALKER}")
    report = walk(
        "--store", real.store, "--row", row, "--duration", 5, "--config", level
    )
    for name in (*GAIN_NAMES, "duration_s", "phi_printed", "phi_corrected"):
        assert (report["gains"] | report)[name] == table[name][row].as_py(), name


BENCH = """
name = "own"
candidates = {{store = "{}", features = ["phi_printed"]}}
goal.value = "cost"
"""


@pytest.mark.slow
def test_the_bench_takes_the_store_and_the_explorer_the_study(
    real, tool, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(BENCH.format(real.store))
    assert tool("bench", "new", "own.toml") == 0
    assert tool("bench", "next", "--json", "next.json") == 0, tool.err
    (proposed,) = json.loads(Path("next.json").read_text())
    rows = open_store(real.store).table((*GAIN_NAMES, *SEARCHED)).to_pylist()
    assert proposed["params"] in rows
    study = open_rows(real.compared, "rough8-smooth/dog/run-001")
    own, seed = walking.OWN, read_experiment(real.config).seed
    setting = walking.chosen_setting(
        ground=own,
        disturbance=own,
        seed=seed,
        world=own,
        engine="taichi",
        duration_s=5.0,
        own=study.document,
    )
    again = walking.walk(gains_at(study, 2, 2), setting)
    for name in ("distance_m", "phi_printed"):
        assert again.row[name] == study.table()[name][2].as_py()
