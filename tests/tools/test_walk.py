"""tools/walk.py as its users run it."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from study.command import run_command
from taichi_nmm.parameters import GAIN_NAMES, K_T

REPOSITORY = Path(__file__).resolve().parents[2]
WALK = REPOSITORY / "tools" / "walk.py"
FLAT = REPOSITORY / "configs" / "flat.toml"

FALLS = dict(zip(GAIN_NAMES, K_T.tolist(), strict=True)) | {"K_SOL": 0.5, "K_VAS": 0.2}


def run(*arguments: str, folder: Path = REPOSITORY) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(WALK), *arguments], cwd=folder, capture_output=True, text=True
    )


def gains_file(folder: Path, gains: dict[str, float]) -> str:
    path = folder / "gains.json"
    path.write_text(json.dumps(gains), encoding="utf-8")
    return str(path)


def test_reference_walks_100_s_at_human_speed_and_json_is_one_object(tmp_path: Path) -> None:
    done = run("--out", str(tmp_path), "--movie-seconds", "1", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["end_reason"] == "completed" and report["duration_s"] == 100.0
    assert report["mean_speed_mps"] == pytest.approx(1.30, abs=0.05)
    assert report["distance_m"] == pytest.approx(100.0 * report["mean_speed_mps"])
    assert set(report["gains"]) == set(GAIN_NAMES)
    pictures = {name: Path(path) for name, path in report["pictures"].items()}
    assert set(pictures) == {"strip", "gait_cycle", "movie"}
    assert all(path.stat().st_size > 10_000 for path in pictures.values())
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "gait_cycle.png", "movie.mp4", "strip.png",
    ]  # fmt: skip


def test_a_walker_that_falls_is_shown_too_from_another_folder(tmp_path: Path) -> None:
    arguments = ("--gains", gains_file(tmp_path, FALLS), "--config", str(FLAT), "--duration", "3")
    done = run(*arguments, "--movie-seconds", "0.3", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fell after" in done.stdout and "cost of transport" in done.stdout
    folder = tmp_path / "out" / "walk" / "gains"
    assert {path.name for path in folder.iterdir()} == {"strip.png", "gait_cycle.png", "movie.mp4"}


# Bad input: one line, exit code 2, and nothing written.

Refused = Callable[..., str]


@pytest.fixture
def refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Refused:
    """Runs the command in this process; returns its one line."""
    specification = importlib.util.spec_from_file_location("walk", WALK)
    assert specification is not None and specification.loader is not None
    command = importlib.util.module_from_spec(specification)
    monkeypatch.setitem(sys.modules, "walk", command)
    monkeypatch.setattr(sys, "path", [*sys.path])
    specification.loader.exec_module(command)
    out = tmp_path / "out"

    def refuse(*arguments: str) -> str:
        defaults = ("--gains", "K_T", "--config", str(FLAT), "--out", str(out))
        monkeypatch.setattr(sys, "argv", ["walk.py", *defaults, *arguments])
        with pytest.raises(SystemExit) as stop:
            run_command(command.main)
        said = capsys.readouterr()
        assert stop.value.code == 2
        assert said.out == "" and said.err.startswith("error: ") and said.err.count("\n") == 1
        assert not out.exists()
        return said.err

    return refuse


def test_unknown_name_or_missing_file(refused: Refused) -> None:
    line = refused("--gains", "nobody.json")
    assert "gains: 'nobody.json'" in line and "K_T, reference" in line


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"K_SOL": float("nan")}, "K_SOL: nan cannot be used; allowed: a finite number"),
        ({"K_SOL": "much"}, "gains.K_SOL: 'much' cannot be used; allowed: a number"),
        ({"K_XYZ": 1.0}, "gains: 'K_XYZ' cannot be used; allowed: only the names"),
    ],
)
def test_gains_that_cannot_be_used(
    refused: Refused, tmp_path: Path, change: dict[str, float], says: str
) -> None:
    assert says in refused("--gains", gains_file(tmp_path, FALLS | change))


def test_a_gain_that_is_missing(refused: Refused, tmp_path: Path) -> None:
    gains = {name: value for name, value in FALLS.items() if name != "l_clr"}
    assert "gains.l_clr: None" in refused("--gains", gains_file(tmp_path, gains))


def test_gains_that_are_not_json(refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "gains.json"
    path.write_text("{", encoding="utf-8")
    assert "a readable JSON object" in refused("--gains", str(path))


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "1e9"])
def test_duration_out_of_range(refused: Refused, seconds: str) -> None:
    assert "duration:" in refused(f"--duration={seconds}")


def test_movie_out_of_range(refused: Refused) -> None:
    assert "movie-seconds: -1.0" in refused("--movie-seconds=-1")


def test_no_ffmpeg(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    assert "allowed: a working ffmpeg" in refused()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sede = 1", "sede: 1"),
        ("[simulation]\nduration_s = 'long'", "simulation.duration_s: 'long'"),
        ("[simulation]\nphysics_step_s = 0.002", "simulation.physics_step_s: 0.002"),
        ("[terrain]\nkind = 'sea'", "terrain.kind: 'sea'"),
        ("[body]\ndisturbance = 2.0", "body.disturbance: 2.0"),
        ("[", "a readable TOML file"),
    ],
)
def test_config_that_cannot_be_used(refused: Refused, tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    assert says in refused("--config", str(path))


def test_the_line_that_the_quickstart_prints_is_taken(tmp_path: Path) -> None:
    config = str(REPOSITORY / "configs" / "rough8.toml")
    gains = gains_file(tmp_path, FALLS)
    where = ("--out", str(tmp_path / "out"), "--duration", "2", "--movie-seconds", "0.3")
    done = run("--gains", gains, "--config", config, *where)
    assert done.returncode == 0, done.stderr


def test_folder_that_cannot_be_written(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    assert "out: " in refused("--out", str(tmp_path / "file" / "below"))


def test_the_process_says_the_same(tmp_path: Path) -> None:
    done = run("--gains", "nobody", "--out", str(tmp_path / "out"))
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: gains: 'nobody'") and done.stderr.count("\n") == 1
