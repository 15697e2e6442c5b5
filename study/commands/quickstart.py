"""Find a walker on rough ground from nothing, by commands that are shown before they run."""

from argparse import Namespace
from importlib import import_module
from pathlib import Path

import optuna

from storage.commit import require_folder
from storage.databases.studies import read_studies, require_lockable
from study.commands.study import command_line, dashboard_command, film_command
from study.experiment.arms import find_arm
from study.experiment.experiment import study_name
from study.experiment.folder import live_artifacts
from study.experiment.trials import study_line
from study.experiment.walker import read_experiment
from study.options import config_path, parser_of

CONFIG, STORE_CONFIG = "rough8", "quickstart-store"
ARMS = ("worlds", "dog", "random")
RUN = 0


def run(command: str, *words: str | Path | int) -> None:
    """Show a command line, and do what it says."""
    line = [command, *map(str, words)]
    print(f"\n{command_line(*line)}", flush=True)
    import_module(f"study.commands.{command}").main(
        parser_of(command).parse_args(line[1:])
    )


def main(args: Namespace) -> None:
    """Do all of it, or the missing part."""
    out: Path = args.out
    require_folder(out)
    experiment, store = read_experiment(config_path(CONFIG)), out / "store"
    url = f"sqlite:///{out / 'studies.db'}"
    names = [study_name(experiment.name, arm, RUN) for arm in ARMS]
    # those that cannot be resumed are refused before the store is made
    for name in names:
        require_lockable(url, name)
    with read_studies(url):
        pass
    run("precompute", "--config", STORE_CONFIG, "--out", store)
    for arm in ARMS:
        given = ("--store", store) if find_arm(arm).store else ()
        run(
            "study",
            "--config",
            CONFIG,
            "--arm",
            arm,
            "--storage",
            url,
            "--out",
            out,
            *given,
        )
    with read_studies(url) as storage:
        assert storage is not None
        studies = [
            optuna.load_study(study_name=name, storage=storage) for name in names
        ]
        costs = [study.best_value for study in studies]
        told = [study_line(experiment, study) for study in studies]
    best = ARMS[costs.index(min(costs))]
    found, drawn = (
        out / f"{best}-run-{RUN:03d}-best.json",
        ("--movie-seconds", 0, "--out"),
    )
    run("walk", "--gains", found, "--config", CONFIG, *drawn, out / "found")
    run("walk", "--gains", "reference", "--duration", 30, *drawn, out / "reference")
    print(
        "",
        *told,
        f"Gains of the best: {found}",
        f"Pictures: {out / 'found'}, {out / 'reference'}",
        f"A film of it: {film_command(found, config_path(CONFIG), RUN)}",
        f"Its store, and its gaits walking: {command_line('explore', str(store))}",
        f"All trials in a browser: {dashboard_command(url, live_artifacts(url, out))}",
        sep="\n",
    )
