"""Compare samplers on machines that somebody measured, and write a page and a picture.

    python tools/compare_measured.py --data DIR                        # all targets
    python tools/compare_measured.py --data DIR --batch 4              # four trials at a time
    python tools/compare_measured.py --data DIR --targets coupling --seeds 3

DIR has `kernels/` and `reactions/`, as their publishers have them; of what is missing a
line says where to get it. The cache keeps finished runs: the same command resumes, and
a run is repeated only where the code or the data that made it have changed. GPSampler
needs PyTorch, which this project does not install: without it this arm is left out.
"""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np

    from storage.inputs.errors import InputError
    from study.pictures import style
    from study.report.figures import trial_axis
    from tools import measured
    from tools.measured import FAMILIES, Target
    from tools.measured_arms import ARMS, MeasuredRun
    from tools.page import write_page
    from tools.runs import Floats, RunOptions, Versus, chosen, execute, runnable

NAME, TITLE = "sampler-measured", "Samplers on measured worlds"
GUIDE = "docs/measured.md"
CHECKPOINTS = (1, 3, 5, 10, 20)  # trials
OURS = ("ours", "ours-scores", "ours-kin")
SHOWN_AT = 10  # trials, of the table of targets


def main() -> None:
    options = parse()
    keys = list(product(options.targets, options.arms))
    runs = [
        MeasuredRun(*key, seed, options.batches, options.data)
        for key in keys
        for seed in range(options.seeds)
    ]
    costs, seconds = execute(runs, options.cache, options.processes)
    shape = (len(keys), options.seeds, options.trials)
    best = np.minimum.accumulate(costs.reshape(shape), axis=2)
    by_arm = seconds.reshape(len(options.targets), -1, options.seeds)
    compared = Comparison(
        targets=[measured.target(options.data, name) for name in options.targets],
        best=dict(zip(keys, best, strict=True)),
        seconds=dict(zip(options.arms, by_arm.swapaxes(0, 1), strict=True)),
    )
    name, title = NAME, TITLE
    if options.batch > 1:
        name, title = (
            f"{name}-by-{options.batch}",
            f"{title}, {options.batch} at a time",
        )
    options.out.mkdir(parents=True, exist_ok=True)
    compared.draw(options.out / f"{name}.png")
    write_page(options.out / f"{name}.md", title, compared.figures(), GUIDE)


def parse() -> Namespace:
    """The options, with lists of targets and of arms that this machine can run."""
    parser = RunOptions(__file__, seeds=10, trials=20, cache="measured")
    parser.path("--data", "that has kernels/ and reactions/", required=True)
    known = f"some of {','.join(FAMILIES)}, or of their targets; all"
    parser.add_argument("--targets", help=known)
    parser.add_argument("--arms", help=f"some of {','.join(ARMS)}; all")
    found = parser.parse_args()
    names = {
        family: measured.names_of(found.data, family)
        for family in measured.families(found.data)
    }
    every = [name for family in names.values() for name in family]
    wanted = chosen("targets", found.targets or ",".join(names), [*names, *every])
    found.targets = [
        name for name in every if {name, name.partition("-")[0]}.intersection(wanted)
    ]
    for name in found.targets:
        half = len(measured.target(found.data, name)) // 2
        if half < found.trials:
            allowed = f"at most {half}, half of the candidates of {name}"
            raise InputError("trials", found.trials, allowed)
    arms = chosen("arms", found.arms or ",".join(ARMS), [*ARMS])
    found.arms = runnable(arms, ARMS)
    return found


class Comparison:
    """The figures of all runs.

    Attributes:
        targets: t of them, in their order.
        best: lowest cost so far, by (target, arm), [seeds, trials].
        seconds: of runs, by arm, [t, seeds].
    """

    def __init__(
        self,
        targets: Sequence[Target],
        best: Mapping[tuple[str, str], Floats],
        seconds: Mapping[str, Floats],
    ) -> None:
        self.targets = targets
        self.best = best
        self.seconds = seconds
        self.arms = [*seconds]
        trials = next(iter(best.values())).shape[1]
        self.checkpoints = [*(at for at in CHECKPOINTS if at < trials), trials]
        self.families = list(dict.fromkeys(target.family for target in targets))

    def lead(self, target: Target, ours: str, other: str, trial: int) -> int:
        """Seeds on which one arm has a lower cost than the other, less those with a higher."""
        mine, theirs = (
            self.best[target.name, arm][:, trial - 1] for arm in (ours, other)
        )
        return int((mine < theirs).sum() - (mine > theirs).sum())

    def regret(self, target: Target, arm: str) -> Floats:
        """How far the best so far is above the least of the seed's half, median, [trials]."""
        rows = [
            target.drawn(seed).regret(costs)
            for seed, costs in enumerate(self.best[target.name, arm])
        ]
        return np.asarray(np.median(rows, axis=0))

    def of_family(self, family: str, arm: str) -> Floats:
        """Mean of the regret over a family's targets, [trials]."""
        targets = [target for target in self.targets if target.family == family]
        return np.asarray(
            np.mean([self.regret(target, arm) for target in targets], axis=0)
        )

    def figures(self) -> list[str]:
        """Tables of won and lost, of regrets, and of the targets."""
        lines = ["## Won and lost, by target"]
        after = "".join(f" after {at} | p |" for at in self.checkpoints)
        for ours in (arm for arm in OURS if arm in self.arms):
            lines += ["", f"| {ARMS[ours].label} against |{after}"]
            lines.append("|---|" + "---:|" * 2 * len(self.checkpoints))
            for other in (arm for arm in self.arms if arm != ours):
                cells = [
                    Versus.of(
                        [self.lead(target, ours, other, at) for target in self.targets]
                    ).cells()
                    for at in self.checkpoints
                ]
                lines.append(f"| {ARMS[other].label} | {' | '.join(cells)} |")
        for family in self.families:
            lines += ["", *self.section(family)]
        return lines

    def section(self, family: str) -> list[str]:
        """A family: the regret of its arms, and its targets."""
        after = "".join(f" after {at} |" for at in self.checkpoints)
        own = [target.family == family for target in self.targets]
        targets = [target for target in self.targets if target.family == family]
        trials = self.checkpoints[-1]
        lines = [
            f"## {family}: {FAMILIES[family].cost}",
            "",
            f"| {FAMILIES[family].regret}: median over seeds, mean over targets | sees |{after}"
            " a proposal, ms |",
            "|---|---|" + "---:|" * (len(self.checkpoints) + 1),
        ]
        for arm in self.arms:
            curve = self.of_family(family, arm)
            cells = " | ".join(f"{curve[at - 1]:.3g}" for at in self.checkpoints)
            proposal_ms = 1000.0 * float(np.median(self.seconds[arm][own])) / trials
            sees = ARMS[arm].sees
            lines.append(
                f"| {ARMS[arm].label} | {sees} | {cells} | {proposal_ms:.3g} |"
            )
        at = min(SHOWN_AT, trials)
        labels = "".join(f" {ARMS[arm].label} |" for arm in self.arms)
        lines += [
            "",
            f"| after {at}, median over seeds | machine | candidates | worlds |{labels}",
            "|---|---|---:|---:|" + "---:|" * len(self.arms),
        ]
        for target in targets:
            cells = " | ".join(
                f"{self.regret(target, arm)[at - 1]:.3g}" for arm in self.arms
            )
            size = f"{len(target) // 2} | {target.outcomes.shape[1]}"
            lines.append(f"| {target.name} | {target.machine} | {size} | {cells} |")
        return lines

    def draw(self, path: Path) -> None:
        """Regret over trials, a panel a family and a line an arm."""
        width, count = 3.0, len(self.families)
        figure = style.new_figure(width * count + 0.5, 3.6, dpi=100)
        trials = self.checkpoints[-1]
        for place, family in enumerate(self.families):
            axes = style.axes_at(figure, 0.6 + width * place, 1.1, width - 0.65, 2.1)
            style.tidy(axes)
            trial_axis(axes, trials)
            axes.set_title(family, **style.TEXT)
            axes.set_ylabel(FAMILIES[family].regret, **style.SMALL)
            for arm, colour in zip(self.arms, COLOURS, strict=False):
                curve = self.of_family(family, arm)
                axes.plot(
                    np.arange(1, trials + 1),
                    np.where(np.isfinite(curve), curve, np.nan),
                    color=colour,
                    label=ARMS[arm].label,
                    linewidth=2.0 if arm in OURS else 1.2,
                    linestyle=STYLES.get(arm, "-"),
                )
            axes.set_ylim(bottom=0.0)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="lower center", ncols=4, frameon=False, fontsize=8
        )
        style.save_png(figure, path)


COLOURS = (style.BLUE, style.BLUE, style.BLUE, style.VERMILION, *style.OTHERS)
STYLES = {"ours-scores": "--", "ours-kin": ":"}

if __name__ == "__main__":
    run_command(main)
