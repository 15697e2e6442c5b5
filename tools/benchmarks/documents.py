"""A document that a tool writes: its bars, its plot, and the line on what made it."""

import json
import os
import platform
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from storage.commit import commit_text, writable
from tools.benchmarks.arms import Arm, Floats

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes", "torch", "greenlet")


class Report(Protocol):
    """Everything that a command measured."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for programs."""

    def markdown(self) -> str:
        """The document."""

    def plot(self, path: Path) -> None:
        """The document's picture."""


def publish(options: Namespace, name: str, report: Report) -> None:
    """Print the report; unless it is printed as JSON, also write `NAME.md` and `NAME.png`.

    Raises:
        InputError: the folder `--out` cannot be written.
    """
    if options.json:
        print(json.dumps(report.as_dict()))
        return
    path, text = options.out / f"{name}.md", report.markdown()
    with writable(path):
        options.out.mkdir(parents=True, exist_ok=True)
    report.plot(path.with_suffix(".png"))
    commit_text(path, text)
    print(text)


@dataclass(frozen=True)
class Bar:
    """A figure that must be reached, the measured value, and whether it is enough."""

    what: str
    measured: str
    holds: bool

    @staticmethod
    def table(bars: Sequence["Bar"], measured: str) -> list[str]:
        """A heading and the bars as rows of Markdown; nothing where there are none."""
        rows = [
            f"| {bar.what} | {bar.measured} | {'yes' if bar.holds else '**no**'} |" for bar in bars
        ]
        head = ["", "## Bars", "", f"| what | {measured} | holds |", "|---|---|---|"]
        return [*head, *rows] if rows else []


def made_by() -> str:
    """The line of a document: command, day, machine and versions that made it."""
    command = " ".join(["python", f"tools/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    return f"Written by `{command}` on {time.strftime('%Y-%m-%d')}: {machine()}; {versions()}."


def machine() -> str:
    """The machine, in words."""
    return f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> str:
    """Python and the packages that decide the figures."""
    found = [f"{name} {installed(name)}" if installed(name) else f"no {name}" for name in PACKAGES]
    return ", ".join([f"Python {platform.python_version()}", *found])


def installed(package: str) -> str:
    """The version of an installed package; "" where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def draw_panels(
    path: Path,
    arms: Mapping[str, Arm],
    problems: Sequence[str],
    curve: Callable[[str, str], Floats | None],
    ylabel: str,
    across: int,
    panel_in: tuple[float, float],
    legend_in: float,
    log: bool = False,
) -> None:
    """Draw a panel for each problem, with a curve [trials] for each arm that has one.

    Args:
        path: of the picture.
        arms: by name.
        problems: titles of the panels.
        curve: of a problem and an arm.
        ylabel: of its values.
        across: panels in a row, at most.
        panel_in: width and height of a panel, inches.
        legend_in: width of the legend at the right, inches.
        log: whether the axis of values is logarithmic.
    """
    from study.pictures import style

    across = min(len(problems), across)
    down = -(-len(problems) // across)
    figure = style.new_figure(panel_in[0] * across + legend_in, panel_in[1] * down)
    for place, problem in enumerate(problems):
        axes = figure.add_subplot(down, across, place + 1)
        style.tidy(axes)
        for name, arm in arms.items():
            if (values := curve(problem, name)) is not None:
                trials = np.arange(1, len(values) + 1)
                axes.plot(trials, values, label=arm.label, **line(arms, name))
        axes.set_yscale("log" if log else "linear")
        axes.set_title(problem, fontsize=style.TITLE_PT, loc="left")
        axes.set_xlabel("trials", fontsize=style.TEXT_PT)
        axes.set_ylabel(ylabel, fontsize=style.TEXT_PT)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    right = 1.0 - legend_in / figure.get_figwidth()
    figure.legend(
        handles, labels, loc="center left", bbox_to_anchor=(right, 0.5),
        fontsize=style.SMALL_PT, frameon=False,
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, right, 1))
    style.save_png(figure, path)


def line(arms: Mapping[str, Arm], name: str) -> dict[str, Any]:
    """Colour, dashes and width of an arm's curve, by its kind and its place among its kind.

    Our arms are in colour and unbroken, peers dashed, controls grey and dotted.
    """
    from study.pictures import style

    kind = arms[name].kind
    place = [other for other, arm in arms.items() if arm.kind == kind].index(name)
    if kind == "ours":
        return {"color": style.SERIES[place % len(style.SERIES)], "linewidth": 1.8}
    if kind == "peer":
        colours = (style.FAINT, style.SKY_BLUE, style.BROWN, style.VIOLET, style.ORANGE)
        colour = colours[place % len(colours)]
        return {"color": colour, "linestyle": "--", "linewidth": 1.3}
    return {"color": style.FAINT, "linestyle": (0, (1, 1 + 2 * place)), "linewidth": 1.3}
