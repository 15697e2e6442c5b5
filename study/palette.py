"""Colours and dashes of every figure: plain values, for Matplotlib, Pillow and plotly alike.

The eight are Okabe and Ito's, which survive colour blindness; so do the lines behind, by dash.
"""

from typing import Any

BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
BROWN, VIOLET = "#A0522D", "#6A3D9A"  # where the eight are used up
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE, BLACK)  # of curves that are all alike
# Plotly's, once the colours are used up.
SERIES_DASHES = ("solid", "dash", "dot", "dashdot", "longdash")

GREY = "#8A9099"  # of what stands back, such as spines and peers

# Of arms: three in front, by their role; all others by their kind, their labels in a darker shade.
FRONT = {"paper": BLUE, "best": VERMILION, "peer": BLACK}
FRONT_DASH: dict[str, Any] = {"paper": (0, (6, 1.6)), "best": "solid", "peer": (0, (2.2, 1.4))}
BACK = {"ours": "#6F9FC6", "peer": GREY, "control": "#C69250"}
BACK_TEXT = {"ours": "#35658C", "peer": "#5A616A", "control": "#85591C"}
BACK_DASH: dict[str, Any] = {"ours": "solid", "peer": (0, (4, 2)), "control": (0, (1, 1.5))}
