"""Strip and gait cycle, as files."""

from pathlib import Path

import pytest
from matplotlib.image import imread

from study.pictures import write_gait_cycle, write_strip
from study.pictures.gait_cycle import SIZE_IN
from study.pictures.style import PNG_DPI
from taichi_nmm.errors import InputError
from taichi_nmm.terrain import flat, ramp, rough
from tests.study import synthetic_gait
from tests.study.synthetic_gait import BODY_WEIGHT_N

pytestmark = pytest.mark.slow

WALK = synthetic_gait.walk()
GLIMPSE = synthetic_gait.walk(0.3)


def shows_something(path: Path) -> bool:
    return bool(imread(path)[..., :3].std() > 0.03)


@pytest.mark.parametrize("terrain", [flat(), rough(1), ramp()], ids=lambda terrain: terrain.name)
@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_strip(tmp_path: Path, trajectory, terrain) -> None:
    path = write_strip(tmp_path / "strip.png", trajectory, terrain, "a title")
    height, width = imread(path).shape[:2]
    assert width >= 5 * PNG_DPI and 2 * PNG_DPI < height < width
    assert shows_something(path)


@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_gait_cycle(tmp_path: Path, trajectory) -> None:
    path = write_gait_cycle(tmp_path / "cycle.png", trajectory, BODY_WEIGHT_N, "a title")
    assert imread(path).shape[:2] == (round(SIZE_IN[1] * PNG_DPI), round(SIZE_IN[0] * PNG_DPI))
    assert shows_something(path)


def test_pictures_are_the_same_every_time(tmp_path: Path) -> None:
    first = write_strip(tmp_path / "1.png", WALK, flat())
    second = write_strip(tmp_path / "2.png", WALK, flat())
    assert first.read_bytes() == second.read_bytes()


def test_unwritable_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for write in (
        lambda path: write_strip(path, GLIMPSE, flat()),
        lambda path: write_gait_cycle(path, GLIMPSE, BODY_WEIGHT_N),
    ):
        with pytest.raises(InputError, match="a place that can be written"):
            write(tmp_path / "file" / "picture.png")
