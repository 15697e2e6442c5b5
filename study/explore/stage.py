"""Walkers that walk on the page: bones and muscles as lines of their thickness, a trail, a clock.

The page's script (scripts/play.mjs) draws the frames; nothing is asked of the server meanwhile.
"""

import html
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.layouts import column
from bokeh.models import (
    Button,
    Column,
    ColumnDataSource,
    CustomJS,
    Div,
    Range1d,
    Select,
    Slider,
    Span,
    Toggle,
)
from bokeh.plotting import figure

from study.explore import walk as walking
from study.explore.server import SCRIPTS, flow
from study.pictures import style
from study.pictures.scene import BELOW_GROUND_M, FORCE_WIDTH_M, VIEW_WIDTH_M
from study.pictures.stick_figure import (
    DRAWN,
    HEAD_RADIUS_M,
    PATH_POINTS,
    TRUNK_WIDTH_M,
    WIDTHS_M,
)
from taichi_nmm.result import FELL, MUSCLES

ASPECT = 1.6  # of a stage, width over height
BONES = (0, 1, 3)  # at which points of a leg's chain thigh, shank and foot begin
GHOST = "#5B4B8A"
GHOST_ALPHA = 0.35
TIMELINE_PX = 110
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x")
COLOURS = (style.MODEL, style.BLACK)  # of the gait and of the one beside it
FORCES = "forces"
RIM_M = 0.008  # of a muscle, both sides together


def walker_lines() -> list[tuple[str, int, int, float, str, int]]:
    """The lines of a walker from the back to the front.

    Each has the name of its frames, its first point there and their count, the width in metres, its
    colour, and the number of its muscle, -1 of a bone.
    """
    lines: list[tuple[str, int, int, float, str, int]] = []
    for key, colour, side in (("far", style.FAR_LIMB, 1), ("near", style.NEAR_LIMB, 0)):
        if side == 0:
            lines.append(("trunk", 0, 2, TRUNK_WIDTH_M, style.NEAR_LIMB, -1))
        lines += [
            (key, at, 2, width, colour, -1) for at, width in zip(BONES, WIDTHS_M, strict=True)
        ]
        for number, muscle in enumerate(MUSCLES, len(MUSCLES) * side):
            at, width = number * PATH_POINTS, DRAWN[muscle]["belly_m"]
            lines.append(("muscles", at, PATH_POINTS, width + RIM_M, style.INK, -1))
            lines.append(("muscles", at, PATH_POINTS, width, walking.COLOURS[0], number))
    return lines + [(FORCES, at, 2, FORCE_WIDTH_M, style.MODEL, -1) for at in (0, 2)]


def line_source(ghost: bool = False) -> ColumnDataSource:
    """Lines that the script moves; a ghost has one colour and no forces."""
    lines = [line for line in walker_lines() if not (ghost and line[0] == FORCES)]
    keys, firsts, counts, metres, colours, muscles = zip(*lines, strict=True)
    empty = [[np.full(count, np.nan, "f4") for count in counts] for _ in "xy"]
    return ColumnDataSource({
        "xs": empty[0], "ys": empty[1], "key": keys, "first": firsts, "metres": metres,
        "width": np.ones(len(lines)), "colour": [GHOST] * len(lines) if ghost else colours,
        "muscle": [-1] * len(lines) if ghost else muscles,
    })  # fmt: skip


def points(count: int) -> ColumnDataSource:
    """Points that the script moves."""
    return ColumnDataSource({"x": np.full(count, np.nan, "f4"), "y": np.full(count, np.nan, "f4")})


class Stage:
    """One walker: muscles coloured by activation, forces of the ground, the trail of the hip."""

    def __init__(self, name: str) -> None:
        self.frames = ColumnDataSource({}, name=f"{name}-frames")
        self.words = Div(text="", styles={"font-size": "13px"}, disable_math=True,
                         sizing_mode="stretch_width")  # fmt: skip
        self._lines, self._ghost_lines = line_source(), line_source(ghost=True)
        self._head, self._ghost_head, self._trail, self._ground = map(points, (1, 1, 2, 2))
        self.figure = self._drawn(name)
        self.layout = column(self.figure, self.words)

    @property
    def parts(self) -> dict[str, Any]:
        """The models that the player's script moves."""
        return {
            "frames": self.frames, "lines": self._lines, "head": self._head, "trail": self._trail,
            "ghost_lines": self._ghost_lines, "ghost_head": self._ghost_head, "figure": self.figure,
        }  # fmt: skip

    def wait(self, name: str) -> None:
        """Say that a gait of this name is being simulated."""
        self.words.text = f"<b>{html.escape(name)}</b>: simulating ..."

    def show(self, walk: walking.Walk) -> None:
        """Begin to play a walk."""
        x, y = walk.frames["ground"].T
        self._ground.data = {"x": x, "y": y}
        self.words.text = f"<b>{html.escape(walk.gains.name)}</b>: {html.escape(walk.ended)}"
        # Each as the one entry of a column, as Bokeh sends arrays of any shape.
        self.frames.data = {name: [values] for name, values in walk.frames.items()}

    def _drawn(self, name: str) -> Any:
        plot = figure(
            name=name, sizing_mode="scale_width", aspect_ratio=ASPECT, tools="",
            toolbar_location=None, x_range=Range1d(0.0, VIEW_WIDTH_M), x_axis_label="distance (m)",
            y_range=Range1d(-BELOW_GROUND_M, VIEW_WIDTH_M / ASPECT - BELOW_GROUND_M), title=" ",
        )  # fmt: skip
        plot.grid.visible = False
        plot.yaxis.visible = False
        plot.varea("x", -1e4, "y", source=self._ground, fill_color=style.GROUND,
                   hatch_pattern="right_diagonal_line", hatch_alpha=0.15)  # fmt: skip
        plot.line("x", "y", source=self._ground, line_color=style.INK, line_width=1.5)
        plot.line("x", "y", source=self._trail, line_color=style.MODEL, line_dash="dotted")
        walkers = (self._ghost_head, self._ghost_lines, GHOST, GHOST_ALPHA), (
            self._head, self._lines, style.NEAR_LIMB, 1.0)  # fmt: skip
        for head, lines, colour, alpha in walkers:
            plot.circle("x", "y", radius=HEAD_RADIUS_M, source=head, color=colour, alpha=alpha)
            plot.multi_line("xs", "ys", source=lines, line_color="colour", line_width="width",
                            line_alpha=alpha, line_cap="round")  # fmt: skip
        return plot


class Player:
    """Two stages, their clock and their time line; the second stage comes with a kept gait.

    `removed` is a button; what it does is the caller's.
    """

    def __init__(self, document: Document) -> None:
        self.stages = (Stage("stage"), Stage("beside"))
        self._play = Toggle(label="play / pause", active=True, name="play")
        speed = Select(title="speed", value="1x", options=list(SPEEDS), name="speed")
        slider = Slider(start=0.0, end=1.0, value=0.0, step=0.01, title="time (s)", name="time")
        self.ghost = Toggle(label="as a ghost", name="ghost")
        self.removed = Button(label="remove", name="remove")
        self._curves = [ColumnDataSource({"x": [], "y": []}) for _ in self.stages]
        self._falls = [
            ColumnDataSource({"x": [], "y": [], "words": []}, name=f"fall-{place}")
            for place in range(len(self.stages))
        ]
        self._cursor = Span(dimension="height", location=0.0, line_color=style.FAINT)
        self._timeline = self._time_plot()
        script = CustomJS.from_file(
            SCRIPTS / "play.mjs",
            stages=[stage.parts for stage in self.stages], play=self._play, speed=speed,
            slider=slider, levels=walking.COLOURS, ghost=self.ghost, cursor=self._cursor,
            view_m=VIEW_WIDTH_M, below_m=BELOW_GROUND_M,
        )  # fmt: skip
        for stage in self.stages:
            stage.frames.js_on_change("data", script)
        slider.js_on_change("value", script)
        self._play.js_on_change("active", script)
        self.ghost.js_on_change("active", script)
        self._timeline.js_on_event("tap", script)
        document.js_on_event(DocumentReady, script)  # frames may have come before the page
        self.ghost.on_change("active", lambda attr, old, new: self._arrange())
        clock = flow(self._play, speed, slider, least_px=100)
        slider.styles = {"flex": "4 1 220px"}
        self._stages = flow(self.stages[0].layout, least_px=340)
        self._beside = flow(self.ghost, self.removed)
        self._beside.visible = False
        self.layout: Column = column(
            self._stages, clock, self._timeline, self._beside, sizing_mode="stretch_width"
        )

    def show(self, walk: walking.Walk, place: int = 0) -> None:
        """Play a walk on a stage, the first or that beside it."""
        self._mark(place, walk)
        self.stages[place].show(walk)
        if place:
            self._beside.visible = True
            self._arrange()

    def remove(self) -> None:
        """Take away the gait that was kept."""
        self.stages[1].frames.data = {}
        self._curves[1].data = {"x": [], "y": []}
        self._falls[1].data = {"x": [], "y": [], "words": []}
        self.ghost.active = self._beside.visible = False
        self._arrange()

    def _arrange(self) -> None:
        """Two stages side by side, or the second gait's words under the ghost."""
        stage, other = self.stages
        other.figure.visible = not self.ghost.active
        shown = [stage.layout, other.layout] if self._beside.visible else [stage.layout]
        if shown != self._stages.children:
            for layout in shown:
                layout.update(sizing_mode="stretch_width", styles={"flex": "1 1 340px"})
            self._stages.children = shown

    def _mark(self, place: int, walk: walking.Walk) -> None:
        time_s, height_m = walk.frames["time_s"], walk.frames["height_m"]
        self._curves[place].data = {"x": time_s, "y": height_m}
        fell = walk.row["end_reason"] == FELL
        at = slice(-1, None) if fell else slice(0, 0)
        words = [f"fell at {time_s[-1]:.1f} s"] if fell else []
        self._falls[place].data = {"x": time_s[at], "y": height_m[at], "words": words}
        ends = [curve.data["x"][-1] for curve in self._curves if len(curve.data["x"])]
        self._timeline.x_range.end = 1.02 * float(max(ends))

    def _time_plot(self) -> Any:
        plot = figure(
            name="timeline", height=TIMELINE_PX, sizing_mode="stretch_width", tools="",
            toolbar_location=None, x_range=Range1d(0.0, 10.0), x_axis_label="time (s)",
            y_axis_label="hip (m)", min_border_top=14,
        )  # fmt: skip
        plot.yaxis.ticker.desired_num_ticks = 3
        for curve, fall, colour in zip(self._curves, self._falls, COLOURS, strict=True):
            plot.line("x", "y", source=curve, line_color=colour)
            plot.scatter("x", "y", source=fall, marker="x", size=13, line_color=style.VERMILION,
                         line_width=3)  # fmt: skip
            plot.text("x", "y", "words", source=fall, text_align="right", x_offset=-12,
                      text_baseline="bottom", y_offset=-4, text_font_size="11px")  # fmt: skip
        plot.add_layout(self._cursor)
        return plot
