"""The cost of a log: its clock in any unit, or a line that says what is wrong with it."""

import math
from datetime import datetime, timedelta

import pytest

from study.bench.walk_log import cost_of_log
from tests.cases import cases, refused

START = datetime(2026, 5, 4, 14, 30, 0, 10_000)
SPEED_MPS = 1.2


def log(folder, clocks, positions, between=","):
    rows = [between.join(row) for row in zip(clocks, positions, strict=True)]
    (folder / "log.csv").write_text("\n".join([f"time{between}position", *rows]) + "\n")
    return folder / "log.csv"


MOMENTS = [START + timedelta(seconds=t) for t in range(31)]
CLOCKS = {
    "seconds": [str(t) for t in range(31)],
    "since 1970": [str(1746369000.01 + t) for t in range(31)],
    "date and time": [str(moment) for moment in MOMENTS],
    "of the day": [str(moment.time()) for moment in MOMENTS],
    "with a zone": [f"{moment.isoformat()}+02:00" for moment in MOMENTS],
}


@pytest.mark.parametrize("clocks", CLOCKS.values(), ids=CLOCKS)
def test_a_walk_costs_the_same_by_any_clock(tmp_path, clocks):
    path = log(tmp_path, clocks, [f"{SPEED_MPS * t:.17g}" for t in range(31)])
    expected = 1 / 31 + 0.3 / 37 + 0.01 * (1.3 - SPEED_MPS)  # 30 s, 36 m
    assert expected == pytest.approx(0.0414, abs=5e-5)
    assert cost_of_log(path, 30.0) == pytest.approx(expected, rel=1e-6)


def test_a_log_with_decimal_commas(tmp_path):
    positions = [f"{SPEED_MPS * t:.3f}".replace(".", ",") for t in range(31)]
    path = log(tmp_path, CLOCKS["date and time"], positions, ";")
    assert cost_of_log(path, 30.0) == pytest.approx(0.0414, abs=5e-5)


@cases("bad-logs.toml", "clocks", "positions", "said")
def test_what_is_no_log_of_a_walk(tmp_path, clocks, positions, said):
    with refused(said):
        cost_of_log(log(tmp_path, clocks.split(), positions.split()), 30.0)


def test_a_log_of_hours_is_none_of_a_walk_without_an_end(tmp_path):
    with refused(r"log.time: '30000 from first to last' .* up to 3600"):
        cost_of_log(log(tmp_path, ["0", "30000"], ["0", "36"]), math.inf)


def test_an_empty_file_and_one_of_other_columns(tmp_path):
    (tmp_path / "log.csv").write_text("")
    with refused(r"log: .*Empty CSV"):
        cost_of_log(tmp_path / "log.csv", 30.0)
    (tmp_path / "log.csv").write_text("t,x\n0,1\n1,2\n")
    with refused(r"log: 'time' .* one of the columns t, x"):
        cost_of_log(tmp_path / "log.csv", 30.0)
