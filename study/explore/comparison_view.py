"""A comparison on the page: a dot a run at its first walker, and each run's robot."""

from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    Column,
    ColumnDataSource,
    CustomJS,
    Div,
    MultiChoice,
    Range1d,
    Select,
    Spinner,
)
from bokeh.models.text import PlainText
from bokeh.models.tools import PanTool, ResetTool, WheelZoomTool
from bokeh.plotting import figure

from study.experiment.experiment import Experiment, study_name
from study.experiment.gains import NamedGains, gains_of_trial
from study.explore.server import SCRIPTS, Message
from study.explore.walk import Setting
from study.pictures import style
from study.report.figures import TICKS, Look, looks, piles, trial_places
from study.report.numbers import by_rank
from study.report.runs import ArmRuns, Results
from taichi_nmm.body import Bodies
from taichi_nmm.errors import InputError
from taichi_nmm.terrain import GRID_X_M

WIDTH_PX = 700
ROW_PX = 34
NONE_AT = 1.12  # where runs without a walker are, of the axis
SHOWN_M = 60.0  # of the ground
DOT_PX = 7


class ComparisonView:
    """The left half of a comparison's page; it calls `watch` with a trial's gains and setting."""

    def __init__(
        self,
        results: Results,
        experiment: Experiment,
        message: Message,
        watch: Callable[[NamedGains, Setting], None],
    ) -> None:
        self._results, self._experiment, self._watch = results, experiment, watch
        self._arms = by_rank(results.arms)
        self._arm = Select(
            title="arm", options=self._arms, value=self._arms[0], width=190, name="arm"
        )
        # without `low` and `high`: the browser would silently replace a wrong number
        self._run = Spinner(title="run", step=1, value=0, mode="int", width=80, name="run")
        self._trial = Spinner(
            title="trial, from 0", step=1, value=0, mode="int", width=100, name="trial"
        )
        shown = MultiChoice(options=self._arms, value=self._arms, width=WIDTH_PX, name="arms")
        self._dots, dots = self._drawn_dots(looks(results.arms))
        for name, of_arm in zip(self._arms, dots, strict=True):
            shown.js_on_change("value", CustomJS(
                args={"dots": of_arm, "name": name},
                code="dots.visible = cb_obj.value.includes(name)",
            ))  # fmt: skip
        self._clicked = ColumnDataSource({"arm": [""], "run": [0], "trial": [0]}, name="clicked")
        message.watch(self._clicked, "data", self._click)
        self._dots.js_on_event("tap", CustomJS.from_file(
            SCRIPTS / "pick.mjs", plot=self._dots, sources=[dot.data_source for dot in dots],
            renderers=dots, arms=self._arms, clicked=self._clicked,
        ))  # fmt: skip
        go = Button(label="watch it", width=90, name="watch")
        go.on_click(message.safely(self.watch_chosen))
        self._robot = Div(text="", name="robot", width=WIDTH_PX)
        self._ground = ColumnDataSource({"x": [], "y": []}, name="ground-profile")
        self._profile = figure(name="profile", width=WIDTH_PX, height=120, tools="",
                               toolbar_location=None, title=" ", y_axis_label="m")  # fmt: skip
        self._profile.line("x", "y", source=self._ground, line_color=style.INK)
        self.layout: Column = column(
            shown, self._dots, row(self._arm, self._run, self._trial, go), self._profile,
            self._robot,
        )  # fmt: skip

    def watch_chosen(self) -> None:
        """Let the chosen trial walk, and show its robot.

        Raises:
            InputError: there is no such trial.
        """
        arm, run, trial = self._arm.value, self._run.value, self._trial.value
        runs = self._results.arms[arm].runs
        if run not in runs:
            raise InputError("run", run, f"{runs.min()} to {runs.max()}, runs of {arm}")
        if trial not in range(self._results.trials):
            raise InputError("trial", trial, f"0 to {self._results.trials - 1}")
        name = f"{study_name(self._results.name, arm, run)}/{trial}"
        gains = gains_of_trial(name, str(self._results.folder))
        setting = Setting(self._experiment, run)
        near = GRID_X_M <= SHOWN_M
        self._ground.data = {"x": GRID_X_M[near], "y": setting.terrain.height_m[near]}
        self._profile.title.text = PlainText(f"ground of run {run}: {setting.terrain.name}")
        self._robot.text = robot_table(setting)
        self._watch(gains, setting)

    def _click(self) -> None:
        arm, run, trial = (self._clicked.data[name][0] for name in ("arm", "run", "trial"))
        self._arm.value, self._run.value, self._trial.value = arm, int(run), int(trial)
        self.watch_chosen()

    def _drawn_dots(self, styles: dict[str, Look]) -> tuple[Any, list[Any]]:
        arms, trials = self._results.arms, self._results.trials
        count = len(self._arms)
        plot = figure(
            name="dots", width=WIDTH_PX, height=ROW_PX * count + 80,
            tools=[PanTool(), WheelZoomTool(), ResetTool()], toolbar_location="right",
            x_range=Range1d(-0.12, 1.22), y_range=Range1d(count - 0.4, -0.6),
            title="trials to the first walker, a dot a run; a click watches it",
        )  # fmt: skip
        plot.toolbar.logo = None
        ticks = [tick for tick in TICKS if tick <= trials]
        places = [*trial_places(ticks, trials).tolist(), NONE_AT]
        words = [*map(str, ticks), "none: best trial"]
        plot.xaxis.ticker = places
        plot.xaxis.major_label_overrides = dict(zip(places, words, strict=True))
        plot.yaxis.ticker = list(range(count))
        plot.yaxis.major_label_overrides = dict(enumerate(self._arms))
        dots = []
        for place, name in enumerate(self._arms):
            source = ColumnDataSource(_dots_of(arms[name], trials, place), name=f"dots-{name}")
            dots.append(plot.scatter("x", "y", source=source, size=DOT_PX, fill_alpha=0.8,
                                     color=styles[name].colour))  # fmt: skip
        return plot, dots


def robot_table(setting: Setting) -> str:
    """A run's body and world in numbers, as HTML."""
    body, world = setting.experiment.body(setting.run), setting.experiment.world(setting.run)
    nominal = Bodies.nominal(1)
    numbers = {}
    for name, field in (("mass", "mass_kg"), ("inertia", "inertia_kgm2"),
                        ("centre of mass", "com_m")):  # fmt: skip
        ratios = getattr(body, field)[0] / getattr(nominal, field)[0]
        numbers[f"{name} over nominal, by link"] = " ".join(f"{each:.2f}" for each in ratios.flat)
    for name in ("friction", "contact_stiffness", "relaxation_speed", "nerve_lag_s",
                 "sensing_noise", "catch_ns"):  # fmt: skip
        numbers[name.replace("_", " ")] = f"{getattr(world, name)[0]:.3g}"
    strength = world.strength[0]
    numbers["strength of muscles"] = f"{strength.min():.2f} to {strength.max():.2f}"
    lines = "".join(f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in numbers.items())
    return f"<b>robot of run {setting.run}</b><table>{lines}</table>"


def _dots_of(arm: ArmRuns, trials: int, place: int) -> dict[str, Any]:
    """Places of an arm's dots, and the trial of each: the first walker, or else the best."""
    first = arm.first_walker
    walks = np.isfinite(first)
    order = np.argsort(np.where(walks, first, np.inf), kind="stable")
    places = np.where(walks, trial_places(first, trials), NONE_AT)
    x, y = piles(places[order])
    trial = np.where(walks, first - 1, arm.best.argmin(axis=1))[order]
    return {"x": x, "y": place + y, "run": arm.runs[order], "trial": trial.astype(np.int64)}
