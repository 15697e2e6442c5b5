"""`taichi-nmm sweep` as its users meet it: files, what is printed, a stop in the middle."""

import csv
import json
from pathlib import Path

import pytest

from study.pictures import style
from tests.study import fake_walker
from tests.study.synthetic_gait import walk
from tests.tools.conftest import Command

REPORT = {"best-cost.png", "best.csv", "report.md", "summary.json"}


@pytest.fixture
def command(tmp_path, tool, simulator):
    config = fake_walker.write_config(tmp_path)
    over = "body.disturbance=0.1:0.2:0.1"
    one = {"arm": "ranking", "workers": 1, "runs": 2, "trials": 3}
    return Command(tool, tmp_path, "sweep", config=config, over=over, **one)


def test_a_report_of_all_values(command):
    found = command.json()
    assert found["out"] == str(command.out)
    assert (found["key"], found["arm"]) == ("body.disturbance", "ranking")
    assert [each["value"] for each in found["values"]] == [0.1, 0.2]
    folder = command.out / "report"
    assert {file.name for file in folder.iterdir()} == REPORT  # fakes are not drawn
    assert json.loads((folder / "summary.json").read_text())["trials"] == 3
    with (folder / "best.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(float(row["body.disturbance"]), row["run"]) for row in rows] == [
        (0.1, "0"),
        (0.1, "1"),
        (0.2, "0"),
        (0.2, "1"),
    ]
    for each in found["values"]:
        own = [row for row in rows if float(row["body.disturbance"]) == each["value"]]
        costs = sorted(float(row["cost"]) for row in own)
        assert each["best_cost"] == pytest.approx(sum(costs) / 2.0)
        assert each["walkers"] == sum(row["walked"] == "true" for row in own)
    text = (folder / "report.md").read_text()
    assert text.startswith("# toy over body.disturbance\n")
    assert "takes few steps" not in text  # fakes have no step to be judged by


def test_a_table_for_people(command):
    assert command.run() == 0
    head, *lines, last = command.tool.out.splitlines()
    assert head.split()[0] == "body.disturbance"
    assert [line.split()[0] for line in lines] == ["0.1", "0.2"]
    assert Path(last) == command.out / "report" / "report.md"


def test_stopped_and_resumed_it_is_the_same(command, simulator):
    assert command.run() == 0
    whole = {
        file.relative_to(command.out): file.read_bytes()
        for file in command.out.rglob("*.*")
        if file.name in ("trials.parquet", *REPORT)
    }
    simulator(fake_walker.stopped_in_call(5))
    stopped = command.folder / "stopped"
    assert command.run(out=stopped) == 130
    assert not (stopped / "report").exists()
    simulator(fake_walker.simulate)
    assert command.run(out=stopped) == 0
    for file, content in whole.items():
        found = (stopped / file).read_bytes()
        if file.name == "summary.json":
            found = found.replace(str(stopped).encode(), str(command.out).encode())
        assert found == content, file


def test_the_arm_is_ours_where_there_is_one(command):
    assert command.json(arm="", runs=1, trials=1)["arm"] == "random"  # the first
    config = command.folder / "toy.toml"
    text = config.read_text()
    config.write_text(text.replace('"dog"', '"worlds"'))
    assert (
        command.json(arm="", runs=1, trials=1, out=command.folder / "new")["arm"]
        == "worlds"
    )


def test_gaits_are_drawn(command, monkeypatch, simulator):
    drawn = []
    save = style.save_png

    def keep(figure, path):
        drawn.append(figure)
        return save(figure, path)

    monkeypatch.setattr(style, "save_png", keep)
    monkeypatch.setattr(fake_walker, "EMPTY", walk())
    assert command.run(runs=1, trials=1) == 0
    names = {file.name for file in (command.out / "report").iterdir()}
    assert names == REPORT | {"gaits.png"}
    titles = [axes.get_title(loc="left") for axes in drawn[-1].axes]
    assert [title.partition(":")[0] for title in titles] == ["0.1", "0.2", ""]
    assert "](gaits.png)" in (command.out / "report" / "report.md").read_text()
