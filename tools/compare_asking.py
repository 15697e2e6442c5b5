"""What it brings to ask a store's simulator about points off its table, on the same robots.

    python tools/compare_asking.py --config ant-robots-four-worlds --simulator ant-four-worlds

`worlds` guesses what such points cost in the worlds from the rows near them; `worlds-asking`
simulates the most promising ones of each trial. `--simulator` is the configuration of the
store, a name or a file. The same command resumes.
"""

from argparse import Namespace
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna
    from optuna.samplers import BaseSampler

    from study.cli import ProgressBar
    from study.experiment.arms import ARMS, OUR_ARM
    from study.experiment.compare import Progress, Request, compare
    from study.experiment.experiment import MOST_RUNS, MOST_TRIALS, store_path
    from study.experiment.features import worlds_function
    from study.experiment.robots import read_any
    from study.experiment.samplers import Task
    from study.options import LARGEST_SEED, Options, config_path
    from study.report.markdown import dashboard_summary
    from study.report.numbers import wilcoxon
    from study.report.runs import read_results
    from study.sampler.sampler import FeatureKernelSampler

ASKING = f"{OUR_ARM}-asking"
AFTER = (5, 10, 15, 20, 30)  # trials


def main() -> None:
    options = parse()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = read_any(options.config, None, options.seed)
    ours = ARMS[OUR_ARM]
    store = store_path(experiment, ours.store)
    in_worlds = experiment.objective.in_worlds
    simulate = worlds_function(store, options.simulator, in_worlds)

    def asking(task: Task) -> BaseSampler:
        success = experiment.objective.success(experiment.trial_s)
        return FeatureKernelSampler(
            task.table, seed=task.seed, success=success, feature_function=simulate
        )

    ARMS[ASKING] = replace(
        ours,
        name=ASKING,
        label="worlds, simulated where asked",
        summary="worlds, which simulates points off the table",
        new_sampler=asking,
        options={**ours.options, "asks": str(options.simulator)},
    )
    out = options.out or Path("out/compare") / f"{experiment.name}-asking"
    request = Request(
        out=out,
        arms=(OUR_ARM, ASKING),
        runs=options.runs,
        trials=options.trials,
        workers=1,  # another process would not know the arm
    )
    with closing(ProgressBar()) as bar:

        def show(progress: Progress) -> None:
            bar.move("trial", progress.trials, progress.total)

        compare(experiment, request, show, dashboard_summary)
    arms = read_results(out).arms
    guessed, asked = arms[OUR_ARM].best, arms[ASKING].best  # [robots, trials]
    print(f"{len(asked)} robots; asked against guessed, won:lost, p, ratio of costs")
    for after in AFTER:
        if after > asked.shape[1]:
            break
        cost, other = asked[:, after - 1], guessed[:, after - 1]
        won, lost = int((cost < other).sum()), int((cost > other).sum())
        p = wilcoxon(other - cost, 0.0 * other).p
        ratio = float(np.exp(np.mean(np.log(cost / other))))
        print(f"after {after:2d}: {won}:{lost}, p = {p:.2g}, {ratio:.2f}")


def parse() -> Namespace:
    parser = Options(__file__)
    for flag, whose in (("--config", "the comparison"), ("--simulator", "its store")):
        about = f"configuration of {whose}, a name or a file"
        parser.add_argument(flag, type=config_path, required=True, help=about)
    parser.whole("--seed", 0, LARGEST_SEED, help="of the robots; the file's")
    parser.whole("--runs", 1, MOST_RUNS, help="robots; as many as the file's")
    parser.whole("--trials", 1, MOST_TRIALS, help="of each robot; the file's")
    parser.path("--out", "folder of the comparison; out/compare/NAME-asking")
    return parser.parse_args()


if __name__ == "__main__":
    run_command(main)
