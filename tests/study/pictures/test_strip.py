"""A strip, as a file."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Annotation

from study.pictures import write_gait_cycle, write_strip
from study.pictures.stick_figure import push_arrows
from study.pictures.strip import Shown, gallery_figure, last_stretch, strips_figure
from study.pictures.style import PNG_DPI, TEXT_PT, new_figure, save_png
from taichi_nmm.terrain import flat, ramp, rough
from tests.cases import refused
from tests.study.synthetic_gait import BODY_WEIGHT_N, GLIMPSE, WALK, walk

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "terrain", [flat(), rough(1), ramp()], ids=lambda terrain: terrain.name
)
@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_a_strip_is_drawn(tmp_path, trajectory, terrain):
    picture = imread(
        write_strip(tmp_path / "strip.png", trajectory, terrain, "a title")
    )
    height, width = picture.shape[:2]
    assert width >= 5 * PNG_DPI and 2 * PNG_DPI < height < width
    assert picture[..., :3].std() > 0.03


def test_uneven_ground_has_a_profile_below_and_pictures_are_the_same_twice(tmp_path):
    def height(terrain):
        file = write_strip(tmp_path / "strip.png", GLIMPSE, terrain, dpi=50)
        return len(imread(file))

    inch = 50
    assert height(rough(1, flat_start_m=0.0)) > height(flat()) + inch
    first = write_strip(tmp_path / "1.png", WALK, flat()).read_bytes()
    assert first == write_strip(tmp_path / "2.png", WALK, flat()).read_bytes()


def test_a_push_and_a_slip_are_drawn_where_and_when_they_come():
    """An arrow to the trunk of the pose of that instant; what came before is told above."""
    once = {"push": np.array([4.4, 0.1, -300.0]), "slip": np.array([6.0, 0.5, 0.1])}
    stretch = last_stretch(Shown("", "a walk", replace(WALK, **once)), flat(), "black")
    assert {4.4, 6.0} < {*stretch.poses_s}
    axes = new_figure(10.0, 4.0).add_axes((0.0, 0.0, 1.0, 1.0))
    stretch.draw(axes)
    words = {text.get_text().strip(): text for text in axes.texts}
    assert words.keys() >= {
        "push of 300 N backwards, 4.40 s",
        "slip, friction 0.1, 6.00 s",
    }
    pushed = WALK.q[WALK.time_s == 4.4]
    expected = push_arrows(pushed, np.array([-300.0]))[0]
    (arrow,) = [text for text in axes.texts if isinstance(text, Annotation)]
    np.testing.assert_allclose([arrow.get_position(), arrow.xy], expected)
    assert axes.get_title(loc="left") == "a walk"
    early = replace(WALK, push=np.array([1.0, 0.1, 50.0]), slip=np.array([9.0, 1, 0.1]))
    last_stretch(Shown("", "a walk", early), flat(), "black").draw(axes)
    told = "a walk Before: push of 50 N forwards, 1.00 s."
    assert axes.get_title(loc="left") == told  # and the walk had ended before the slip


@pytest.mark.parametrize(
    "terrain", [rough(1, flat_start_m=1.0), ramp()], ids=["rough", "ramp"]
)
def test_two_walks_are_drawn_on_one_ground(tmp_path, terrain):
    fell = Shown("taichi", "taichi: fell", walk(0.3, 50.0))
    walked = Shown("mujoco", "mujoco: walked", walk(12.0, 50.0))
    figure = strips_figure((fell, walked), terrain, "made-up")
    file = save_png(figure, tmp_path / "strips.png")
    assert file.stat().st_size > 50_000


def test_an_unwritable_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    place = tmp_path / "file" / "picture.png"
    with refused("a place that can be written"):
        write_strip(place, GLIMPSE, flat())
    with refused("a place that can be written"):
        write_gait_cycle(place, GLIMPSE, BODY_WEIGHT_N)


@pytest.mark.parametrize("length", [10, 120])
def test_a_title_is_one_line_within_the_figure(length):
    title = "w" * length
    shown = Shown("label", title, GLIMPSE)
    for figure in (
        strips_figure([shown], flat(), title),
        gallery_figure([(shown, flat())] * 2, title),
    ):
        lines = [*figure.texts, *(axes._left_title for axes in figure.axes)]
        found = [line for line in lines if line.get_text() == title]
        assert len(found) >= 2
        for line in found:
            box = line.get_window_extent()
            assert 0.0 < box.x0 < box.x1 < figure.bbox.width
            assert (line.get_fontsize() < TEXT_PT) is (length > 10)


def test_many_walks_stand_beside_each_other():
    shown = [(Shown(str(number), str(number), GLIMPSE), flat()) for number in range(5)]
    *panels, _ = gallery_figure(shown, "made-up").axes
    assert [panel.get_title(loc="left") for panel in panels] == [
        "0",
        "1",
        "2",
        "3",
        "4",
    ]
    boxes = [panel.get_position().bounds for panel in panels]
    assert len({round(left, 9) for left, *_ in boxes}) == 3
    assert len({round(bottom, 9) for _, bottom, *_ in boxes}) == 2
    scales = [panel.get_data_ratio() for panel in panels]
    assert max(scales) == pytest.approx(min(scales))
