"""A walk on the page: the stick figure that plays, its gait cycle, and its scores."""

import html
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Column, ColumnDataSource, CustomJS, Div, Range1d, Select, Slider, Toggle
from bokeh.plotting import figure

from study.explore.server import SCRIPTS
from study.explore.walk import COLOURS, Walk
from study.pictures import style
from study.pictures.gait_cycle import (
    PANELS,
    PERCENT,
    SOURCE,
    human_distances,
    strides_of,
    subtitle,
)
from study.pictures.scene import BELOW_GROUND_M, VIEW_WIDTH_M
from study.pictures.stick_figure import HEAD_RADIUS_M, PATH_POINTS, finite
from taichi_nmm.result import MUSCLES, OUTCOME_FIELDS, SCORE_FIELDS

FRAME_PX = (720, 370)
BONE_PX = 7
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x")
MUSCLE_COUNT = 2 * len(MUSCLES)
HEIGHT_M = VIEW_WIDTH_M * FRAME_PX[1] / FRAME_PX[0]


def points(count: int) -> ColumnDataSource:
    """Points of a line, which the script moves."""
    return ColumnDataSource({"x": np.full(count, np.nan, "f4"), "y": np.full(count, np.nan, "f4")})


def outlines(parts: int, count: int, **more: Any) -> ColumnDataSource:
    """The same of several lines or patches."""
    xs, ys = ([np.full(count, np.nan, "f4") for _ in range(parts)] for _ in range(2))
    return ColumnDataSource({"xs": xs, "ys": ys, **more})


class Stage:
    """One walker, drawn as in films: muscles by activation, forces of the ground."""

    def __init__(self, name: str) -> None:
        self.frames = ColumnDataSource({}, name=f"{name}-frames")
        self.words = Div(text="", styles={"font-size": "13px"}, disable_math=True)
        self._near, self._far = points(5), points(5)
        self._trunk, self._head = points(2), points(1)
        colour = [COLOURS[0]] * MUSCLE_COUNT
        self._muscles = outlines(MUSCLE_COUNT, 2 * PATH_POINTS, colour=colour)
        self._forces = outlines(2, 2)
        self._ground = points(2)
        self.figure = self._drawn(name)
        self.layout = column(self.figure, self.words)

    @property
    def parts(self) -> dict[str, Any]:
        """The models that the player's script moves."""
        return {
            "frames": self.frames, "near": self._near, "far": self._far, "trunk": self._trunk,
            "head": self._head, "muscles": self._muscles, "forces": self._forces,
            "figure": self.figure,
        }  # fmt: skip

    def show(self, walk: Walk) -> None:
        """Begin to play a walk."""
        x, y = walk.frames["ground"].T
        self._ground.data = {"x": x, "y": y}
        self.words.text = f"<b>{html.escape(walk.gains.name)}</b>: {html.escape(walk.ended)}"
        # Each as the one entry of a column, as Bokeh sends arrays of any shape.
        self.frames.data = {name: [values] for name, values in walk.frames.items()}

    def _drawn(self, name: str) -> Any:
        plot = figure(
            name=name, frame_width=FRAME_PX[0], frame_height=FRAME_PX[1], tools="",
            toolbar_location=None, x_range=Range1d(0.0, VIEW_WIDTH_M),
            y_range=Range1d(-BELOW_GROUND_M, HEIGHT_M - BELOW_GROUND_M), title=" ",
        )  # fmt: skip
        plot.grid.visible = False
        plot.yaxis.visible = False
        plot.varea("x", -1e4, "y", source=self._ground, fill_color=style.GROUND)
        plot.line("x", "y", source=self._ground, line_color=style.INK, line_width=1.5)
        for bones, colour in ((self._far, style.FAR_LIMB), (self._trunk, style.NEAR_LIMB),
                              (self._near, style.NEAR_LIMB)):  # fmt: skip
            plot.line("x", "y", source=bones, line_color=colour, line_width=BONE_PX,
                      line_cap="round", line_join="round")  # fmt: skip
        plot.circle("x", "y", radius=HEAD_RADIUS_M, source=self._head, color=style.NEAR_LIMB)
        plot.patches("xs", "ys", fill_color="colour", source=self._muscles, line_color=style.INK,
                     line_width=0.5)  # fmt: skip
        plot.multi_line("xs", "ys", source=self._forces, line_color=style.MODEL, line_width=3)
        return plot


class Player:
    """Two stages and the clock of both; the second stage is off the page until a walk is kept."""

    def __init__(self) -> None:
        self.stages = (Stage("stage"), Stage("beside"))
        play = Toggle(label="play / pause", active=True, width=100, name="play")
        speed = Select(value="1x", options=list(SPEEDS), width=80)
        slider = Slider(start=0.0, end=1.0, value=0.0, step=0.01, title="time (s)", width=480,
                        name="time")  # fmt: skip
        script = CustomJS.from_file(
            SCRIPTS / "play.mjs",
            stages=[stage.parts for stage in self.stages], play=play, speed=speed, slider=slider,
            levels=COLOURS,
        )  # fmt: skip
        for stage in self.stages:
            stage.frames.js_on_change("data", script)
        slider.js_on_change("value", script)
        play.js_on_change("active", script)
        self._controls = row(play, speed, slider)
        self.layout: Column = column(self.stages[0].layout, self._controls)

    def show(self, walk: Walk, place: int = 0) -> None:
        """Play a walk on a stage; the second stage comes to the page with its first walk."""
        if place:
            self.layout.children = [*(stage.layout for stage in self.stages), self._controls]
        self.stages[place].show(walk)


SIZE_PX = (232, 170)
COLUMNS = 3
FULL = "deg"  # of a name: an angle


class Cycle:
    """A small figure for each joint and each ground force."""

    def __init__(self) -> None:
        self._words = Div(text="", name="cycle", width=SIZE_PX[0] * COLUMNS)
        self._curves: dict[str, ColumnDataSource] = {}
        self._figures = {}
        for name, panel in PANELS.items():
            plot = figure(
                name=f"cycle-{panel.title}", width=SIZE_PX[0], height=SIZE_PX[1], tools="",
                toolbar_location=None, title=panel.title, y_axis_label=panel.unit,
                x_range=(0, 100), y_range=(panel.low, panel.high),
            )  # fmt: skip
            mean, sd = panel.at(PERCENT)
            plot.varea(PERCENT, mean - sd, mean + sd, fill_color=style.HUMAN, fill_alpha=0.35)
            plot.line(PERCENT, mean, line_color=style.FAINT, line_dash="dashed")
            empty = np.full(len(PERCENT), np.nan)
            source = ColumnDataSource({"x": PERCENT, "y": empty}, name=f"cycle-{name}")
            plot.line("x", "y", source=source, line_color=style.MODEL, line_width=2)
            plot.title.text_font_size = "10px"
            self._curves[name], self._figures[name] = source, plot
        plots = list(self._figures.values())
        self.layout: Column = column(self._words, row(*plots[:COLUMNS]), row(*plots[COLUMNS:]))

    def show(self, walk: Walk) -> None:
        """The mean stride of a walk that has enough strides."""
        strides = strides_of(finite(walk.trajectory), walk.experiment.weight_n(0))
        distances = human_distances(strides)
        self._words.text = f"{subtitle(strides)} Grey: {SOURCE}. Numbers: RMSE."
        for name, panel in PANELS.items():
            curves = getattr(strides, name)
            mean = curves.mean(axis=0) if strides.enough else np.full(len(PERCENT), np.nan)
            self._curves[name].data = {"x": PERCENT, "y": mean}
            title = panel.title.removeprefix("ground ")
            if name in distances:
                unit = "deg" if name.endswith(FULL) else "bw"
                far = distances[name]
                title += f": {far.rmse:.3g} {unit}, {far.deviations:.2g} sd"
            self._figures[name].title.text = title


LEFT_OUT = ("end_reason", "hip_x_m", "hip_z_m")
FIELDS = tuple(name for name, _ in (*OUTCOME_FIELDS, *SCORE_FIELDS) if name not in LEFT_OUT)
HEAD = "<tr><th align=left></th><th>start</th><th>now</th><th>change</th></tr>"


class Score:
    """A table of numbers of two walks on the same ground."""

    def __init__(self) -> None:
        self._start: np.void | None = None
        self.layout = Div(text="", name="score", width=420)

    def show(self, row: np.void, start: bool) -> None:
        """The result row of a walk; later rows are compared with that of a `start`."""
        if start or self._start is None:
            self._start = row
        text = HEAD
        for name in FIELDS:
            before, now = float(self._start[name]), float(row[name])
            change = "" if before == now else f"{now - before:+.3g}"
            text += f"<tr><td>{name}</td>"
            for cell in (f"{before:.4g}", f"{now:.4g}", f"<b>{change}</b>"):
                text += f"<td align=right>{cell}</td>"
            text += "</tr>"
        self.layout.text = f"<table cellspacing=4>{text}</table>"
