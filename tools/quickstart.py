"""From nothing to a walker on rough ground: a small store, two studies, pictures.

It does what tools/precompute.py, tools/study.py and tools/walk.py do, one after the other, and goes
on where it was stopped.
"""

import argparse
import os
import sys
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import optuna
from tqdm import tqdm

import taichi_nmm
from storage.commit import commit_json
from storage.databases.studies import only_run, open_studies, storage_errors
from storage.precompute import precompute
from storage.specification import read_specification
from study.command import run_command
from study.config import StudyConfig, read_study_config
from study.feature_table import FeatureTable
from study.objective import simulate_gains, trial_gains
from study.runner import run_study, study_name
from study.summary import best_gains, dashboard_command, progress_line, study_line
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.config import read_toml
from taichi_nmm.result import Result
from taichi_nmm.terrain import Terrain, flat

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
ARMS = ("dog", "random")
TRIALS = 30  # of each: about where the paper finds its walkers
REFERENCE_S = 30.0  # of the reference gait, for its pictures


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/quickstart"), metavar="DIR")
    return parser.parse_args()


def make_store(path: Path) -> FeatureTable:
    specification = read_specification(read_toml(CONFIGS / "quickstart-store.toml"))
    duration_s = specification.conditions.duration_s
    say(f"1. Scoring {specification.samples} walkers, {duration_s:g} s on flat ground")
    with tqdm(total=specification.samples, unit="walker") as bar:
        precompute(specification, path, progress=lambda points: bar.update(int(points) - bar.n))
    return FeatureTable.from_parquet(path, features=["phi_printed"])


def run_arm(config: StudyConfig, arm: str, url: str, table: FeatureTable) -> optuna.Study:
    storage = open_studies(url)
    with only_run(url, study_name(config, arm)), storage_errors(url):
        return run_study(
            config,
            arm,
            TRIALS,
            storage,
            table if arm == "dog" else None,
            report=lambda study, trial: say(progress_line(study, trial, TRIALS)),
        )


def draw_found(out: Path, config: StudyConfig, study: optuna.Study) -> list[Path]:
    result = simulate_gains(config, trial_gains(study.best_trial), record=True)
    title = f"Found by {study.study_name}"
    return draw(out, "found", title, result, config.terrain, config.bodies)


def draw_reference(out: Path, config: StudyConfig) -> list[Path]:
    result = taichi_nmm.simulate(
        taichi_nmm.load_gains("reference"),
        duration_s=REFERENCE_S,
        settings=config.settings,
        record=(0,),
    )
    return draw(out, "reference", "Reference gait", result, flat(), Bodies.nominal())


def draw(
    out: Path, name: str, title: str, result: Result, ground: Terrain, bodies: Bodies
) -> list[Path]:
    from study import pictures  # here, where matplotlib is needed

    trajectory, weight_n = result.trajectories[0], float(bodies.mass_kg.sum()) * GRAVITY_MPS2
    title = f"{title}: {result.end_reason[0]} {result['duration_s'][0]:.0f} s"
    return [
        pictures.write_strip(out / f"{name}_strip.png", trajectory, ground, title),
        pictures.write_gait_cycle(out / f"{name}_gait_cycle.png", trajectory, weight_n, title),
    ]


def say(*lines: str) -> None:
    print(*lines, sep="\n", flush=True)


def main() -> None:
    out: Path = parse().out
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    config = read_study_config(CONFIGS / "rough8.toml")
    table = make_store(out / "store")
    url = f"sqlite:///{out / 'studies.db'}"
    say(f"2. {TRIALS} trials with each sampler: {config.duration_s:g} s on {config.terrain.name}")
    studies = [run_arm(config, arm, url, table) for arm in ARMS]
    best = min(studies, key=lambda study: study.best_value)
    commit_json(out / "found.json", best_gains(best))
    say("3. Drawing the best walker found, and the reference gait")
    paths = draw_found(out, config, best) + draw_reference(out, config)
    say(
        "",
        *(study_line(study) for study in studies),
        f"Gains of the best: {out / 'found.json'}",
        f"Pictures: {', '.join(str(path) for path in paths)}",
        f"A film of it: {os.path.relpath(sys.executable)} tools/walk.py "
        f"--gains {out / 'found.json'} --config configs/rough8.toml",
        f"All trials in a browser: {dashboard_command(url)}",
    )


if __name__ == "__main__":
    run_command(main)
