"""Benches with a robot for a machine."""

import pytest

from study.bench.bench import Bench
from tests.study.bench import robot


@pytest.fixture(params=[robot.WORLDS, robot.FEATURES], ids=["worlds", "features"])
def path(request, tmp_path):
    """The file of a bench, whose candidates have worlds or features."""
    return robot.write(tmp_path, request.param)


@pytest.fixture
def bench(tmp_path):
    """A bench that has begun, over candidates with worlds."""
    return Bench.new(robot.write(tmp_path), "me")
