"""Walkers that walk on the page: bones and muscles as lines of their thickness, a trail, a clock.

The page's script (scripts/play.mjs) draws the frames; nothing is asked of the server
meanwhile.
"""

import html
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import (
    Button,
    ColorBar,
    Column,
    ColumnDataSource,
    CustomJS,
    Div,
    FixedTicker,
    LinearColorMapper,
    Select,
    Slider,
    Span,
    Toggle,
)
from bokeh.plotting import figure

from study.explore.server import SCRIPTS, flow
from study.explore.walk import COLOURS, Walk
from study.explore.words import Tables
from study.pictures import stick_figure as stick
from study.pictures import style
from study.pictures.gait_cycle import PEOPLE
from study.pictures.scene import (
    ARROWS,
    BELOW_GROUND_M,
    DEVICE_KEY,
    FORCE_WIDTH_M,
    VIEW_WIDTH_M,
)
from taichi_nmm.result import MUSCLES

ASPECT = 1.45  # of a stage, width over height
GHOST = "#5B4B8A"
GHOST_ALPHA = 0.35
STAGE_PX = 280  # the least width of a stage: two are beside each other at 1280
TIMELINE_PX = 110  # its height
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x")
OVER_TIME = "over time"  # tags figures on which a tap moves the clock
LEGEND = "muscle activation, 0 to 1; left leg in front"  # of the bar
RIM_M = 0.008  # of a muscle, both sides together
# As frames have them: their lines and activations are in the order of `MUSCLES`, those
# of the left leg, then those of the right.
MUSCLE_LOOKS = [
    (f"{name}, {PEOPLE['muscles'][name]}", stick.DRAWN[name]["belly_m"])
    for name in MUSCLES
]

LOOKS: Tables = {  # of which the script makes the lines of a walker
    "bones": list(stick.WIDTHS_M),
    "trunk": stick.TRUNK_WIDTH_M,
    "pylon": stick.PYLON_WIDTH_M,
    "strut": stick.STRUT_WIDTH_M,
    "arc": stick.ARC_WIDTH_M,
    "device": style.DEVICE,
    "torque": style.TORQUE,
    "rim": RIM_M,
    "muscles": MUSCLE_LOOKS,
    "points": stick.PATH_POINTS,
    "turn": stick.ARC_POINTS + 3,  # points of an arrow round a joint
    "force": FORCE_WIDTH_M,
    "ghost": GHOST,
    "arrows": list(ARROWS),
    "ink": style.INK,
    "far": style.FAR_LIMB,
    "near": style.NEAR_LIMB,
    "levels": COLOURS,
}


class Stage:
    """One walker: muscles coloured by activation, forces of the ground, the trail of the hip."""

    def __init__(self, name: str) -> None:
        self.frames = ColumnDataSource({}, name=f"{name}-frames")
        self.words = Div()
        self._ground = ColumnDataSource({"x": [], "y": []})
        self.figure = self._drawn(name)
        self.layout = Column(self.figure, self.words)

    def say(self, name: str, words: str) -> None:
        """Tell what a gait of this name does."""
        self.words.text = f"<b>{html.escape(name)}</b>: {html.escape(words)}"

    def show(self, walk: Walk | None) -> None:
        """Begin to play a walk; or take it away."""
        if walk is None:
            self.frames.data = {}
            self.words.text = ""
            return
        x, y = walk.frames["ground"].T
        self._ground.data = {"x": x, "y": y}
        key = f" ({DEVICE_KEY})" if "arrows" in walk.frames else ""
        self.say(walk.gains.name, f"{walk.ended}{key}")
        # Each as the one entry of a column, as Bokeh sends arrays of any shape.
        sent = {**walk.frames, "ended": walk.ended}
        self.frames.data = {name: [values] for name, values in sent.items()}

    def _drawn(self, name: str) -> Any:
        """The script moves all of its renderers but the ground, which are the first two."""
        plot = figure(
            name=name,
            sizing_mode="scale_width",
            aspect_ratio=ASPECT,
            tools="",
            toolbar_location=None,
            title=" ",
            x_axis_label="distance (m)",
            x_range=(0.0, VIEW_WIDTH_M),
            y_range=(-BELOW_GROUND_M, VIEW_WIDTH_M / ASPECT - BELOW_GROUND_M),
        )
        plot.grid.visible = plot.yaxis.visible = False
        plot.varea(
            "x",
            -1e4,
            "y",
            source=self._ground,
            fill_color=style.GROUND,
            hatch_pattern="right_diagonal_line",
            hatch_alpha=0.15,
        )
        plot.line("x", "y", source=self._ground, line_color=style.INK, line_width=1.5)
        nowhere = np.full((2, 1), np.nan, "f4")
        plot.line(*nowhere, line_color=style.MODEL, line_dash="dotted")
        mapper = LinearColorMapper(palette=COLOURS, low=0.0, high=1.0)
        bar = ColorBar(
            color_mapper=mapper,
            title=LEGEND,
            height=8,
            padding=0,
            ticker=FixedTicker(ticks=[]),
        )
        plot.add_layout(bar, "below")
        # Head, then bones and muscles, of a ghost and of the walker.
        for colour, alpha in ((GHOST, GHOST_ALPHA), (style.NEAR_LIMB, 1.0)):
            plot.circle(*nowhere, radius=stick.HEAD_RADIUS_M, color=colour, alpha=alpha)
            plot.multi_line(
                [], [], line_color=[], line_width=[], alpha=alpha, line_cap="round"
            )
        return plot


class Player:
    """Two stages, their clock and their time line; the second stage comes with a kept gait.

    `removed` is a button; what it does is the caller's. `script` moves the clock to the
    time of a tap on a figure.
    """

    def __init__(self, document: Document) -> None:
        self.stages = (Stage("stage"), Stage("beside"))
        play = Toggle(label="play / pause", active=True, name="play")
        speed = Select(title="speed", value="1x", options=list(SPEEDS), name="speed")
        slider = Slider(
            title="time (s)", start=0, end=1, value=0, step=0.01, name="time"
        )
        ghost = Toggle(label="as a ghost", name="ghost")
        self.removed = Button(label="remove", name="remove")
        timeline = _timeline()
        self.script = script = CustomJS.from_file(
            SCRIPTS / "play.mjs",
            stages=[
                {"frames": each.frames, "figure": each.figure, "layout": each.layout}
                for each in self.stages
            ],
            play=play,
            speed=speed,
            slider=slider,
            looks=LOOKS,
            ghost=ghost,
            timeline=timeline,
            view_m=VIEW_WIDTH_M,
            below_m=BELOW_GROUND_M,
            least=f"{STAGE_PX}px",
        )
        for stage in self.stages:
            stage.frames.js_on_change("data", script)
            for event in ("mousemove", "mouseleave", "tap"):
                stage.figure.js_on_event(event, script)
        slider.js_on_change("value", script)
        for toggle in (play, ghost):
            toggle.js_on_change("active", script)
        timeline.js_on_event("tap", script)
        # Frames may have come before the page.
        document.js_on_event(DocumentReady, script)
        clock = flow(play, speed, slider, least_px=100)
        slider.styles = {"flex": "4 1 220px"}
        stages = flow(*(stage.layout for stage in self.stages), least_px=STAGE_PX)
        self._beside = flow(ghost, self.removed)
        self._beside.visible = self.stages[1].layout.visible = False
        self.layout = Column(stages, clock, timeline, self._beside)

    def show(self, walk: Walk | None, place: int = 0) -> None:
        """Play a walk on a stage, the first or that beside it; none takes the second away."""
        self.stages[place].show(walk)
        if place:
            self._beside.visible = self.stages[1].layout.visible = walk is not None


def _timeline() -> Any:
    """Heights of the hips over time, where each walker fell, and a cursor."""
    plot = figure(
        name="timeline",
        tags=[OVER_TIME],
        height=TIMELINE_PX,
        tools="",
        toolbar_location=None,
        x_range=(0.0, 10.0),
        x_axis_label="time (s)",
        y_axis_label="hip (m)",
        min_border_top=14,
    )
    plot.yaxis.ticker.desired_num_ticks = 3
    for place, colour in enumerate((style.MODEL, style.BLACK)):
        plot.line([], [], line_color=colour)
        fall = ColumnDataSource(
            {name: [] for name in ("x", "y", "words", "align", "offset")},
            name=f"fall-{place}",
        )
        plot.scatter(
            "x",
            "y",
            source=fall,
            marker="x",
            size=13,
            line_color=style.VERMILION,
            line_width=3,
        )
        plot.text(
            "x",
            "y",
            "words",
            source=fall,
            text_align="align",
            x_offset="offset",
            text_baseline="bottom",
            y_offset=-4,
            text_font_size="11px",
        )
    # It moves with each frame: Bokeh paints an overlay without the axes.
    cursor = {"location": 0.0, "line_color": style.FAINT, "level": "overlay"}
    plot.add_layout(Span(dimension="height", **cursor))
    return plot
