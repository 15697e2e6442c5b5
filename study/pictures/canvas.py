"""A small drawing surface in metres, for films: many frames a second, edges smooth.

Matplotlib takes 25 ms for a frame, Pillow 2. Shapes are drawn twice as large and shrunk; text is
drawn at its size. Pillow comes with matplotlib, and so does the font.
"""

from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Array = NDArray[np.float64]
Colour = str | tuple[int, ...]

SMOOTHING = 2  # shapes are drawn this much larger
ARC = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
CIRCLE = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
FONT = "fonts/ttf/DejaVuSans.ttf"


class Canvas:
    """A picture of a part of the plane; first the shapes, then `finish`, then the text.

    Attributes:
        picture: at its size, once finished.
    """

    picture: Image.Image

    def __init__(
        self, size_px: tuple[int, int], left_m: float, bottom_m: float, width_m: float
    ) -> None:
        """An empty white picture that shows `width_m` from `left_m` on, upwards of `bottom_m`."""
        large = (size_px[0] * SMOOTHING, size_px[1] * SMOOTHING)
        scale = large[0] / width_m
        self._px_per_m = np.array([scale, -scale])
        self._corner_m = np.array([left_m, bottom_m + large[1] / scale])  # left, top
        self._large = Image.new("RGB", large, "white")
        self._draw = ImageDraw.Draw(self._large)

    def polygon(self, points_m: Array, fill: Colour, edge: Colour | None = None) -> None:
        """A filled polygon [k, 2], with a hair line round it if `edge` is given."""
        self._draw.polygon(self._pixels(points_m), fill=fill, outline=edge)

    def line(self, points_m: Array, colour: Colour, width_px: float) -> None:
        """A line through points [k, 2], of a width on the finished picture."""
        width = max(round(width_px * SMOOTHING), 1)
        self._draw.line(self._pixels(points_m), fill=colour, width=width)

    def capsule(self, start_m: Array, end_m: Array, width_m: float, fill: Colour) -> None:
        """A thick line with round ends."""
        self.polygon(capsule(start_m, end_m, width_m), fill)

    def disc(self, centre_m: Array, radius_m: float, fill: Colour) -> None:
        """A filled circle."""
        self.polygon(centre_m + radius_m * np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], -1), fill)

    def finish(self) -> None:
        """Shrink the shapes to the picture's size."""
        self.picture = self._large.reduce(SMOOTHING)
        self._text = ImageDraw.Draw(self.picture)

    def text(
        self, at_px: tuple[float, float], text: str, size_px: int, colour: Colour, anchor: str
    ) -> None:
        """Words on the finished picture; `anchor` as Pillow's: "la" left top, "ma" middle top."""
        self._text.text(at_px, text, fill=colour, font=font(size_px), anchor=anchor)

    def place(self, x_m: float, z_m: float) -> tuple[float, float]:
        """Pixel of a point on the finished picture."""
        x, z = self._pixels(np.array([[x_m, z_m]]))
        return x / SMOOTHING, z / SMOOTHING

    def _pixels(self, points_m: Array) -> list[float]:
        """x, y, x, y, ... on the large picture."""
        pixels: list[float] = ((points_m - self._corner_m) * self._px_per_m).ravel().tolist()
        return pixels


def capsule(start_m: Array, end_m: Array, width_m: float) -> Array:
    """Outline of a thick line with round ends, [k, 2]."""
    direction = np.arctan2(end_m[1] - start_m[1], end_m[0] - start_m[0])
    ends = [(end_m, direction + ARC), (start_m, direction + np.pi + ARC)]
    arcs = [c + 0.5 * width_m * np.stack([np.cos(a), np.sin(a)], -1) for c, a in ends]
    return np.concatenate(arcs)


@cache
def font(size_px: int) -> ImageFont.FreeTypeFont:
    """Matplotlib's own font, so that a film looks as the pictures do."""
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / FONT), size_px)
