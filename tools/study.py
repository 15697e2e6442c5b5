"""Run one study of the walker: a sampler proposes gains, the simulator tries them.

    python tools/study.py --config configs/rough8.toml --sampler dog --trials 30 \\
        --storage sqlite:///out/studies.db

The same command goes on where it was stopped. Exit codes: 0, 2 bad input, 130 interrupted.
"""

import argparse
import json
import sys
from pathlib import Path

# The repository comes before tools/, where this file would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import optuna

from storage.commit import commit_json, writable
from storage.databases.studies import only_run, open_studies, shown_url, storage_errors
from study.arms import ARMS, read_table
from study.command import require_arch, run_command
from study.config import read_study_config
from study.runner import check_trials, run_study, study_name
from study.summary import best_gains, progress_line, summary, summary_text
from taichi_nmm.settings import ARCHITECTURES


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", required=True, help="TOML, such as configs/rough8.toml")
    parser.add_argument("--sampler", choices=ARMS, required=True)
    parser.add_argument("--trials", type=int, default=30, help="in total (%(default)s)")
    parser.add_argument("--storage", required=True, help="sqlite:///FILE, or of PostgreSQL")
    parser.add_argument("--store", help="scores, for dog and best; default: the config's")
    parser.add_argument("--out", type=Path, help="for the best gains; default: out/NAME")
    parser.add_argument("--arch", choices=ARCHITECTURES, help="overrides the config's")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser.parse_args()


def main() -> None:
    args = parse()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    config = read_study_config(args.config, args.arch)
    shown_url(args.storage)  # refuses what is no such URL
    table = read_table(args.sampler, config, args.store)
    check_trials(args.trials, table)
    require_arch(config.settings)
    gains = (args.out or Path("out") / config.name) / f"{args.sampler}-best.json"
    with writable(gains.parent):
        gains.parent.mkdir(parents=True, exist_ok=True)
    storage = open_studies(args.storage)

    def report(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        print(progress_line(study, trial, args.trials), file=sys.stderr, flush=True)

    with only_run(args.storage, study_name(config, args.sampler)), storage_errors(args.storage):
        study = run_study(config, args.sampler, args.trials, storage, table, report)
        commit_json(gains, best_gains(study))
        if args.json:
            print(json.dumps(summary(study, args.storage, gains)))
        else:
            print(summary_text(study, args.storage, gains))


if __name__ == "__main__":
    run_command(main)
