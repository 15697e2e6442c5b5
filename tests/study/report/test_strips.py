"""The figure of two walks, on any ground."""

from pathlib import Path

import pytest

from study.report.before_after import Pair, Shown, write_strips
from taichi_nmm.terrain import ramp, rough
from tests.study import synthetic_gait


@pytest.mark.parametrize("ground", ["rough", "ramp"])
def test_strips_are_drawn_on_the_ground(tmp_path: Path, ground: str) -> None:
    terrain = rough(1, flat_start_m=1.0) if ground == "rough" else ramp()
    walks = [
        Shown(when, f"{when}: somebody", synthetic_gait.walk(seconds, 50.0))
        for when, seconds in (("before", 0.3), ("after", 12.0))
    ]
    files = write_strips(tmp_path, "made-up", Pair(0, terrain, *walks))
    assert [file.name for file in files] == ["strips.png", "strips.svg"]
    assert min(file.stat().st_size for file in files) > 50_000
