"""Draws docs/img/walker.png: the walker, with the labels and the reflexes of walker.toml."""

import tomllib
from pathlib import Path

import numpy as np

from study.pictures import style
from study.pictures.stick_figure import LEFT, RIGHT, draw_walker, leg, muscle_outlines, trunk
from taichi_nmm.result import MUSCLES

DOCS = Path(__file__).parent
POSE = np.array([0.0, 0.98, 0.08, -0.28, 0.12, 0.0, 0.36, 0.62, 0.5])  # m, then rad
DPI = 88
COLOURS = {"excites": style.BLUE, "inhibits": style.VERMILION}

drawing = tomllib.loads((DOCS / "walker.toml").read_text(encoding="utf-8"))
figure = style.new_figure(8.4, 6.6, DPI)
axes = style.axes_at(figure, 0.0, 0.0, 8.4, 6.6)
axes.set(xlim=(-1.3, 1.3), ylim=(-0.1, 1.9428))
axes.axis("off")
draw_walker(axes, POSE, np.full(14, 0.1), layer=3.0)
outlines, joints = muscle_outlines(POSE, LEFT), leg(POSE, LEFT)
places = dict(zip(MUSCLES, (outline.mean(axis=0) for outline in outlines), strict=True))
places |= {"trunk": trunk(POSE)[0], "knee": joints.knee, "ball": joints.ball}
places["swing"] = leg(POSE, RIGHT).ankle
for label in drawing["labels"]:
    axes.annotate(
        label["text"], places[label["of"]], label["at"],
        fontsize=style.TEXT_PT, color=style.INK,
        ha="left" if label["at"][0] > 0.0 else "right", va="center", zorder=9.0,
        arrowprops={"arrowstyle": "-", "color": style.FAINT, "linewidth": 0.7},
    )  # fmt: skip
for row, (kind, colour) in enumerate(COLOURS.items()):
    axes.text(-1.25, 1.88 - 0.06 * row, kind, color=colour, fontsize=style.TEXT_PT, va="top")
    for start, end, bend in drawing[kind]:
        axes.annotate(
            "", places[end], places[start], zorder=8.0,
            arrowprops={"arrowstyle": "-|>" if kind == "excites" else "|-|,widthA=0,widthB=0.4",
                        "color": colour, "linewidth": 1.6,
                        "connectionstyle": f"arc3,rad={bend}"},
        )  # fmt: skip
style.save_png(figure, DOCS / "img" / "walker.png")
