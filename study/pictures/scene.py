"""The frames of a film: the walker over its ground, painted on a small surface in metres.

Matplotlib takes 25 ms for a frame, Pillow 2. Shapes are drawn twice as large and
shrunk, so that edges are smooth; text is drawn at its size. Pillow comes with
Matplotlib, and so does the font.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from study.pictures import stick_figure as stick
from study.pictures import style
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

Array = NDArray[np.float64]

SMOOTHING = 2  # shapes are drawn this much larger
FONT = "fonts/ttf/DejaVuSans.ttf"


class Canvas:
    """A part of the plane: draw the shapes, call `finish`, write the text on `picture`."""

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

    def polygon(self, points_m: Array, fill: str) -> None:
        """A filled polygon [k, 2]."""
        self._draw.polygon(self._pixels(points_m), fill=fill)

    def muscles(self, outlines: Sequence[Array], activation: Array, edge: str) -> None:
        """Filled outlines [k, 2], coloured by activation, with a hair line round each."""
        colours = stick.COLOURS(activation, bytes=True)[:, :3].tolist()
        for outline, colour in zip(outlines, colours, strict=True):
            pixels = self._pixels(outline)
            self._draw.polygon(pixels, fill=tuple(colour), outline=edge)

    def line(self, points_m: Array, colour: str, width_px: float) -> None:
        """A line through points [k, 2], of a width on the finished picture."""
        width = max(round(width_px * SMOOTHING), 1)
        self._draw.line(self._pixels(points_m), fill=colour, width=width)

    def disc(self, centre_m: Array, radius_m: float, colour: str) -> None:
        """A filled circle."""
        self._draw.circle(self._pixels(centre_m), radius_m * self._px_per_m[0], colour)

    def joints(self, points_m: Array) -> None:
        """Small dots [k, 2]."""
        for point in points_m:
            self.disc(point, JOINT_RADIUS_M, style.INK)

    def bones(self, parts: Iterable[stick.Bone], colour: str) -> None:
        """Thick lines with round ends."""
        for start_m, end_m, width_m in parts:
            width = round(width_m * self._px_per_m[0])
            self._draw.line(self._pixels(np.stack([start_m, end_m])), colour, width)
            for end in (start_m, end_m):
                self.disc(end, 0.5 * width_m, colour)

    def finish(self) -> None:
        """Shrink the shapes to the picture's size."""
        self.picture = self._large.reduce(SMOOTHING)
        self._text = ImageDraw.Draw(self.picture)

    def text(
        self,
        at_px: tuple[float, float],
        text: str,
        size_px: int,
        anchor: str,
    ) -> None:
        """Words on the finished picture; `anchor` as Pillow's: "la" left top, "ma" middle top."""
        self._text.text(at_px, text, fill=style.INK, font=font(size_px), anchor=anchor)

    def place(self, x_m: float, z_m: float) -> tuple[float, float]:
        """Pixel of a point on the finished picture."""
        x, z = self._pixels(np.array([[x_m, z_m]]))
        return x / SMOOTHING, z / SMOOTHING

    def _pixels(self, points_m: Array) -> list[float]:
        """x, y, x, y, ... on the large picture."""
        pixels = (points_m - self._corner_m) * self._px_per_m
        return list(pixels.ravel().tolist())


@cache
def font(size_px: int) -> ImageFont.FreeTypeFont:
    """Matplotlib's own font, so that films look like the pictures."""
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / FONT), size_px)


FULL_WIDTH_PX = 1280  # at which the sizes of text and lines are given
VIEW_WIDTH_M = 4.7  # room for a title above the head
BELOW_GROUND_M = 0.30
AHEAD = 0.45  # where the walker is in the picture, from the left
HEIGHT_TRACKING_S = 0.5  # the camera follows the ground's rise as slowly as this
FORCE_WIDTH_M = 0.014
JOINT_RADIUS_M = 0.007
ARROWS = (style.MODEL, style.MODEL, style.BLACK)  # of forces: on both feet, a push
PRESSURE_SHIFT_M = 0.05  # heel above ball by half of it: all the force is at the ball
FORCE_SMOOTHING_S = 0.03  # impacts of a few milliseconds would only flicker
KEY = "blue: force of the ground"
PUSH_KEY = "; black: a push"
SLIP_KEY = "; orange ground: slippery"
DEVICE_KEY = "green: torque of the exoskeleton, half a turn at 80 N m"
SMALLEST_TEXT_PX = 9  # of a film a quarter of the full size


@dataclass(frozen=True)
class Film:
    """How a film is made.

    Attributes:
        size_px: width and height of a frame; even numbers: yuv420p halves both.
        rate_hz: frames a second.
        effort: of the encoder: a preset of x264.
        quality: of the encoder: its constant rate factor; lower is better.
        threads: of the encoder; 0 leaves the number to it.
    """

    size_px: tuple[int, int]
    rate_hz: int
    effort: str
    quality: int
    threads: int


LARGE = Film(size_px=(1280, 640), rate_hz=30, effort="medium", quality=20, threads=0)
"""For one walk: 1280 x 640 pixels."""

SMALL = Film(size_px=(640, 320), rate_hz=20, effort="veryfast", quality=26, threads=1)
"""For many: 8 s are 0.2 MB, and a second of one core."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A walk at the times of its f frames.

    Attributes:
        time_s: [f].
        q: generalised coordinates, as in `Trajectory`, [f, 9].
        activation: of the muscles, left leg first, 0 to 1, [f, 14].
        force_n: of the ground on the left foot, then the right, forward and up each,
            smoothed, [f, 4].
        push_n: of a push on the trunk, forwards, [f].
        level_m: the ground's height that the camera follows, [f].
        sliding: whether a slip goes on, bool [f].
        device: an exoskeleton; None: there is none.
        prosthesis: whether the left leg, and the right, has one.
    """

    time_s: Array
    q: Array
    activation: Array
    force_n: Array
    push_n: Array
    level_m: Array
    sliding: NDArray[np.bool_]
    device: stick.Device | None = None
    prosthesis: Sequence[bool] = (False, False)


def frames(
    trajectory: Trajectory,
    terrain: Terrain,
    seconds: float,
    title: str,
    film: Film = LARGE,
) -> Iterator[bytes]:
    """RGB frames of the last `seconds`, as bytes."""
    motion = motion_of(stick.finite(trajectory), terrain, seconds, film.rate_hz)
    scene = Scene(motion, terrain, title, film.size_px)
    for number in range(len(motion.time_s)):
        yield scene.picture(number)


def motion_of(
    trajectory: Trajectory, terrain: Terrain, seconds: float, rate_hz: int
) -> Motion:
    """The last `seconds` of a walk whose poses are finite, `rate_hz` frames a second."""
    end_s = trajectory.time_s[-1]
    start_s = max(trajectory.time_s[0], end_s - seconds)
    times_s = np.arange(start_s, end_s + 1e-9, 1.0 / rate_hz)
    q = stick.at_times(trajectory, trajectory.q, times_s)
    slips_s, lasts_s, _ = trajectory.slip
    return Motion(
        time_s=times_s,
        q=q,
        activation=stick.at_times(trajectory, trajectory.activation, times_s),
        force_n=stick.at_times(trajectory, smooth_force(trajectory), times_s),
        push_n=stick.at_times(trajectory, trajectory.push_n, times_s)[:, 0],
        level_m=camera_level(terrain.height(q[:, 0]), rate_hz),
        sliding=(times_s >= slips_s) & (times_s < slips_s + lasts_s),
        device=stick.device_at(trajectory, times_s),
        prosthesis=trajectory.prosthesis.tolist(),
    )


class Scene:
    """Draws the frames of one film."""

    def __init__(
        self, motion: Motion, terrain: Terrain, title: str, size_px: tuple[int, int]
    ) -> None:
        self._motion = motion
        self._terrain = terrain
        self._title = title
        self._size_px = size_px
        self._unit_px = size_px[0] / FULL_WIDTH_PX
        self._arrows = force_arrows(motion)
        self._walker = stick.Walker(
            motion.q, motion.activation, motion.device, motion.prosthesis
        )
        self._bar = self._activation_bar()

    def picture(self, number: int) -> bytes:
        """Frame `number` as RGB bytes."""
        left_m = self._motion.q[number, 0] - AHEAD * VIEW_WIDTH_M
        bottom_m = self._motion.level_m[number] - BELOW_GROUND_M
        canvas = Canvas(self._size_px, left_m, bottom_m, VIEW_WIDTH_M)
        self._walker.draw(canvas, number)
        for (foot, tip), colour in zip(self._arrows[number], ARROWS, strict=True):
            if np.hypot(*(tip - foot)) > FORCE_WIDTH_M:
                canvas.bones([(foot, tip, FORCE_WIDTH_M)], colour)
        ink = style.VERMILION if self._motion.sliding[number] else style.INK
        metres = self._draw_ground(canvas, left_m, bottom_m, ink)
        canvas.finish()
        self._write(canvas, number, metres)
        canvas.picture.paste(self._bar, (round(0.9 * self._size_px[0]), 0), self._bar)
        return canvas.picture.tobytes()

    def _draw_ground(
        self, canvas: Canvas, left_m: float, bottom_m: float, ink: str
    ) -> list[int]:
        """The ground with a mark at every metre; returns the metres that are in the picture."""
        x = np.linspace(left_m, left_m + VIEW_WIDTH_M, self._size_px[0] // 2)
        profile = np.stack([x, self._terrain.height(x)], axis=1)
        corners = np.array([[x[-1], bottom_m], [x[0], bottom_m]])
        canvas.polygon(np.concatenate([profile, corners]), style.GROUND)
        canvas.line(profile, ink, 1.4 * self._unit_px)
        metres = list(range(int(np.ceil(left_m)), int(x[-1]) + 1))
        for metre in metres:
            top = float(self._terrain.height(metre))
            mark = np.array([[metre, top - 0.05], [metre, top]])
            canvas.line(mark, style.INK, 1.4 * self._unit_px)
        return metres

    def _write(self, canvas: Canvas, number: int, metres: list[int]) -> None:
        time_s, x_m = self._motion.time_s[number], self._motion.q[number, 0]
        wide, high = self._size_px
        left = 0.015 * wide
        self._write_title(canvas, left)
        key = KEY
        if self._motion.push_n.any():
            key += PUSH_KEY
        if self._motion.sliding.any():
            key += SLIP_KEY
        lines = [(f"{time_s:6.2f} s   {x_m:7.2f} m", 18), (key, 15)]
        if self._motion.device is not None:
            lines.append((DEVICE_KEY, 15))
        for line, (text, size) in enumerate(lines, start=1):
            at = (left, (0.03 + 0.06 * line) * high)
            canvas.text(at, text, self._text_px(size), "la")
        for metre in metres:
            at = canvas.place(metre, float(self._terrain.height(metre)) - 0.08)
            canvas.text(at, f"{metre} m", self._text_px(15), "ma")

    def _write_title(self, canvas: Canvas, left: float) -> None:
        """One line, smaller where it would reach the edge."""
        size, room = self._text_px(18), self._size_px[0] - 2.0 * left
        over = font(size).getlength(self._title) / room
        size = int(size / max(over, 1.0))
        canvas.text((left, 0.03 * self._size_px[1]), self._title, max(size, 1), "la")

    def _text_px(self, size_px: int) -> int:
        return max(round(size_px * self._unit_px), SMALLEST_TEXT_PX)

    def _activation_bar(self) -> Image.Image:
        """The key to the muscles' colours, the tenth of the picture at its right."""
        dpi = 72.0 * self._text_px(14) / style.SMALL_PT
        figure = style.new_figure(
            0.1 * self._size_px[0] / dpi, self._size_px[1] / dpi, dpi
        )
        stick.activation_bar(figure.add_axes((0.25, 0.45, 0.12, 0.4)))
        picture = BytesIO()
        figure.savefig(picture, transparent=True)
        return Image.open(picture)


def force_arrows(motion: Motion) -> Array:
    """Forces as foot and tip: of the ground on the left foot and the right, a push; [f, 3, 2, 2].

    Those of the ground begin at the lower end of a tilted foot, at the middle of a flat
    one. A push ends at the trunk's centre of mass; NaN where there is none.
    """
    arrows = []
    for side in (stick.LEFT, stick.RIGHT):
        joints = stick.leg(motion.q, side)
        tilt_m = joints.heel[:, 1:] - joints.ball[:, 1:]
        share = np.clip(0.5 + tilt_m / PRESSURE_SHIFT_M, 0.0, 1.0)
        foot = joints.heel + share * (joints.ball - joints.heel)
        push = stick.FORCE_M_PER_N * stick.of_side(motion.force_n, side)
        arrows.append(np.stack([foot, foot + push], axis=1))
    arrows.append(stick.push_arrows(motion.q, motion.push_n))
    return np.stack(arrows, axis=1)


def camera_level(ground_m: Array, rate_hz: int) -> Array:
    """The ground's height at each frame, smoothed for a calm camera."""
    blend = 1.0 / (rate_hz * HEIGHT_TRACKING_S)
    level, _ = lfilter(
        [blend], [1.0, blend - 1.0], ground_m, zi=(1.0 - blend) * ground_m[:1]
    )
    return np.asarray(level)


def smooth_force(trajectory: Trajectory) -> Array:
    """Ground forces averaged over a few samples, [t, 4]."""
    interval_s = np.diff(trajectory.time_s[:2]).sum() or 1.0
    width = max(round(FORCE_SMOOTHING_S / interval_s), 1)
    return np.asarray(
        uniform_filter1d(trajectory.ground_force_n, width, axis=0, mode="nearest")
    )
