"""A strip, as a file."""

from pathlib import Path

import pytest
from matplotlib.image import imread

from study.pictures import write_gait_cycle, write_strip
from study.pictures.strip import Shown, strips_figure
from study.pictures.style import PNG_DPI, save_png
from taichi_nmm import InputError, Trajectory
from taichi_nmm.terrain import Terrain, flat, ramp, rough
from tests.study.synthetic_gait import BODY_WEIGHT_N, GLIMPSE, WALK, walk

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "terrain", [flat(), rough(1), ramp()], ids=lambda terrain: terrain.name
)
@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_a_strip_is_drawn(
    tmp_path: Path, trajectory: Trajectory, terrain: Terrain
) -> None:
    picture = imread(
        write_strip(tmp_path / "strip.png", trajectory, terrain, "a title")
    )
    height, width = picture.shape[:2]
    assert width >= 5 * PNG_DPI and 2 * PNG_DPI < height < width
    assert picture[..., :3].std() > 0.03


def test_uneven_ground_has_a_profile_below_and_pictures_are_the_same_twice(
    tmp_path: Path,
) -> None:
    def height(terrain: Terrain) -> int:
        file = write_strip(tmp_path / "strip.png", GLIMPSE, terrain, dpi=50)
        return len(imread(file))

    inch = 50
    assert height(rough(1, flat_start_m=0.0)) > height(flat()) + inch
    first = write_strip(tmp_path / "1.png", WALK, flat()).read_bytes()
    assert first == write_strip(tmp_path / "2.png", WALK, flat()).read_bytes()


@pytest.mark.parametrize(
    "terrain", [rough(1, flat_start_m=1.0), ramp()], ids=["rough", "ramp"]
)
def test_two_walks_are_drawn_on_one_ground(tmp_path: Path, terrain: Terrain) -> None:
    fell = Shown("taichi", "taichi: fell", walk(0.3, 50.0))
    walked = Shown("mujoco", "mujoco: walked", walk(12.0, 50.0))
    figure = strips_figure((fell, walked), terrain, "made-up")
    file = save_png(figure, tmp_path / "strips.png")
    assert file.stat().st_size > 50_000


def test_an_unwritable_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    place = tmp_path / "file" / "picture.png"
    with pytest.raises(InputError, match="a place that can be written"):
        write_strip(place, GLIMPSE, flat())
    with pytest.raises(InputError, match="a place that can be written"):
        write_gait_cycle(place, GLIMPSE, BODY_WEIGHT_N)
