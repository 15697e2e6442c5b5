"""taichi-nmm walk as its users run it: gains from everywhere, and pictures."""

import json
import re
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import imageio_ffmpeg
import mujoco
import optuna
import pytest
from optuna.distributions import FloatDistribution

from storage.store import columns_of, open_store
from storage.tables import document_hash, write_table
from study import pictures
from study.experiment.gains import gains_of_row, row_at_speed
from study.experiment.walker import read_experiment
from study.pictures import LARGE
from taichi_nmm.parameters import GAIN_NAMES, PUBLISHED_GAINS
from taichi_nmm.result import ENERGY, OF_MUSCLES
from tests.study import fake_walker, synthetic_gait
from tests.study.experiment.test_front import front
from tests.tools.running import ROOT

FLAT = ROOT / "configs" / "flat.toml"
ROUGH8 = ROOT / "configs" / "rough8.toml"
HARD = ROOT / "configs" / "mujoco-rough8-hard.toml"

PICTURES = {"strip.png", "gait_cycle.png", "movie.mp4"}
WALKS = dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True))
FALLS = WALKS | {"K_SOL": 0.5, "K_VAS": 0.2}


def gains_file(folder, gains):
    path = folder / "gains.json"
    path.write_text(json.dumps(gains))
    return path


@pytest.mark.slow
def test_the_reference_walks_100_s_and_json_is_one_object(tmp_path, tool):
    report = tool.json("walk", "--out", tmp_path, "--movie-seconds", 1)
    assert report["end_reason"] == "completed" and report["duration_s"] == 100.0
    assert report["mean_speed_mps"] == pytest.approx(1.30, abs=0.05)
    assert report["distance_m"] == pytest.approx(100.0 * report["mean_speed_mps"])
    assert set(report["gains"]) == set(GAIN_NAMES)
    muscles = report[OF_MUSCLES]
    assert 1.1 * muscles < report[ENERGY] < 1.4 * muscles
    assert report["mass_kg"] == pytest.approx(80.0)
    assert report["ended"].startswith("walked 100.0 s")
    drawn = {name: Path(path) for name, path in report["pictures"].items()}
    assert set(drawn) == {"strip", "gait_cycle", "movie"}
    assert all(path.stat().st_size > 10_000 for path in drawn.values())
    assert {path.name for path in tmp_path.iterdir()} == PICTURES


@pytest.mark.slow
def test_a_faller_is_shown_too(tmp_path, tool, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gains = gains_file(tmp_path, FALLS)
    words = f"--gains {gains} --config flat --duration 3 --movie-seconds".split()
    assert tool("walk", *words, 0.3) == 0
    assert "fell after" in tool.out and "foot touched last" in tool.out
    (folder,) = (tmp_path / "out" / "walk").iterdir()
    assert {path.name for path in folder.iterdir()} == PICTURES
    # No step was scored.
    for unknown in ("knee in swing (deg, flexion +)", "distance from people"):
        assert re.search(rf"^{re.escape(unknown)}.* -( .*)?$", tool.out, re.MULTILINE)
    assert "not human" not in tool.out
    report = tool.json("walk", *words, 0)
    assert report["step_count"] == 0
    assert report["human_deviation"] is report["hip_torque_peak_nm"] is None
    assert len([*folder.parent.iterdir()]) == 1  # the same walk


@pytest.mark.slow
def test_mujoco_moves_the_body_and_opens_its_file(tmp_path, tool):
    """An existing file is replaced; another engine makes another walk, and the same file."""
    model, folder = tmp_path / "walker.xml", tmp_path / "opensim"
    model.write_text("old")
    line = (
        f"walk --gains published --config {HARD} --run 3 --duration 3 --movie-seconds 0"
    )
    words = (*line.split(), "--out", tmp_path / "out", "--mjcf", model)
    report = tool.json(*words, "--opensim", folder)
    assert report["duration_s"] == 3.0 and 2.0 < report["distance_m"] < 6.0
    assert set(report["pictures"]) == {"strip", "gait_cycle", "mjcf", "opensim"}
    files = [".mot", ".mot", ".osim", ".sto", ".sto", ".xml"]
    assert sorted(path.suffix for path in folder.iterdir()) == files
    assert report["pictures"]["mjcf"] == str(model)
    text, opened = model.read_text(), mujoco.MjModel.from_xml_path(str(model))
    body = read_experiment(HARD).body(3)
    assert opened.body_mass[1:].tolist() == body.mass_kg[0].tolist()
    assert opened.nkey == 1 and opened.nu == 6
    assert opened.opt.timestep == 0.5e-3 and (opened.geom_solref[:, 0] == 0.005).all()
    own = tool.json(*words, "--engine", "taichi")
    assert own["distance_m"] != report["distance_m"]
    assert model.read_text() == text
    assert tool(*words, "--engine", "both") == 0
    end, other_end, head, *lines = tool.out.splitlines()
    assert "taichi: walked 3.0 s" in end and "mujoco: walked 3.0 s" in other_end
    assert head.split() == ["taichi", "mujoco", "people"]
    for kind, label in ((ENERGY, "energy of muscles"), (OF_MUSCLES, "of the muscles")):
        (line,) = (line for line in lines if line.startswith(label))
        assert line.split()[-3:-1] == [f"{one[kind]:.2f}" for one in (own, report)]
    for name, one in (("taichi", own), ("mujoco", report)):
        told = [line for line in lines if line.startswith(f"not human, {name}: ")]
        assert [line.partition(": ")[2] for line in told] == one["not_human"] != []


@pytest.fixture
def walk(tmp_path, tool, simulator, monkeypatch):
    """Runs the command, with simulator and painters replaced; returns what it prints as JSON."""
    for name in ("write_strip", "write_gait_cycle", "write_movies"):
        monkeypatch.setattr(pictures, name, lambda path, *_: path)
    return partial(tool.json, "walk", "--out", tmp_path / "out")


def test_a_trial_that_walks_elsewhere_than_it_was_made_is_told(
    walk, tmp_path, tool, monkeypatch
):
    """Its cost would be taken for that of the study."""
    monkeypatch.setattr(fake_walker, "EMPTY", synthetic_gait.walk())
    url = f"sqlite:///{tmp_path}/live.db"
    study = optuna.create_study(study_name="rough8/dog/run-002", storage=url)
    spans = {name: FloatDistribution(-100.0, 100.0) for name in WALKS}
    study.add_trial(optuna.create_trial(params=WALKS, distributions=spans, value=1.0))
    of_trial = "--trial", "rough8/dog/run-002/0", "--storage", url
    of_trial += "--before", of_trial[1]
    walk(*of_trial)
    told = "made in rough8, run 2, and walks in flat, run 0"
    assert f"warning: trial: {told}" in tool.err
    assert f"warning: before: {told}" in tool.err
    walk(*of_trial, "--config", ROUGH8, "--run", 2)
    assert "warning" not in tool.err


def test_a_result_is_taken_as_gains_and_low_level_gains_count(walk, tmp_path):
    first = walk("--gains", gains_file(tmp_path, FALLS | {"theta_ref": 0.2}))
    assert walk("--gains", gains_file(tmp_path, first)) == first
    assert first["gains"] == FALLS | {"theta_ref": 0.2}
    plain = walk("--gains", gains_file(tmp_path, WALKS))
    bent = walk("--gains", gains_file(tmp_path, WALKS | {"theta_ref": 0.5}))
    assert set(plain["gains"]) == set(GAIN_NAMES)
    assert set(bent["gains"]) == {*GAIN_NAMES, "theta_ref"}
    assert bent["distance_m"] < plain["distance_m"]
    assert fake_walker.calls[-1]["low_level_gains"][fake_walker.THETA_REF] == 0.5


def test_two_walks_are_never_in_one_folder(walk, tool, tmp_path, monkeypatch):
    """By default another name for each; a picture that this walk does not make is in the way."""
    monkeypatch.chdir(tmp_path)
    weak = tmp_path / "weak.toml"
    weak.write_text(FLAT.read_text() + "\n[world]\nstrength = [0.8, 0.8]\n")
    walks = (
        "--config flat",
        f"--config {weak}",
        f"--config {weak} --run 1",
        f"--config {weak} --seed 9",
        f"--config {weak} --duration 3",
        f"--config {weak} --engine mujoco",
        "--gains published",
    )
    folders = []
    for line in (*walks, *walks):
        strip = Path(tool.json("walk", *line.split())["pictures"]["strip"])
        folders.append(strip.parent.name)
    assert folders[: len(walks)] == folders[len(walks) :]  # the same walk, the same one
    assert len(set(folders)) == len(walks)
    assert {name[:10] for name in folders} == {"reference-", "published-"}
    film = tmp_path / "out" / "movie.mp4"
    film.write_text("a healthy walk")
    words = f"walk --config {weak} --movie-seconds 0 --out {film.parent}".split()
    tool.refuses("out: '.*movie.mp4' .* a folder without it", *words)
    assert film.read_text() == "a healthy walk"


@pytest.mark.slow
def test_a_gait_is_shown_beside_that_of_before(tmp_path, tool):
    """Both are in the table, the strips and the film; numbers and other pictures are its own."""
    slow = gains_file(tmp_path, WALKS | {"K_SOL": 0.9 * WALKS["K_SOL"]})
    words = ["walk", "--duration", 3, "--movie-seconds", 0.3, "--out"]
    alone = tool.json(*words, tmp_path / "alone", "--gains", slow)
    both = tool.json(
        *words, tmp_path / "both", "--gains", slow, "--before", "published"
    )
    assert set(both.pop("pictures")) == {*alone.pop("pictures"), "strips"}
    assert both == alone
    for name in ("strip.png", "gait_cycle.png"):
        found, own = (tmp_path / folder / name for folder in ("both", "alone"))
        assert found.read_bytes() == own.read_bytes()
    shown = imageio_ffmpeg.read_frames(str(tmp_path / "both" / "movie.mp4"))
    width, height = LARGE.size_px
    assert next(shown)["size"] == (width, 2 * height)
    shown.close()
    line = (*words, tmp_path / "both", "--gains", slow, "--before", "published")
    assert tool(*line) == 0
    first, second, head, *lines = tool.out.splitlines()
    assert first.startswith("published, then gains on flat, before: walked 3.0 s")
    assert second.startswith("published, then gains on flat, after: walked 3.0 s")
    assert head.split() == ["before", "after", "people"]
    (energy,) = (each for each in lines if each.startswith("of the muscles"))
    assert energy.split()[-2] == f"{alone[OF_MUSCLES]:.2f}" != energy.split()[-3]


def test_before_is_a_walk_of_its_own(walk, tool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("study.pictures.strip.strips_figure", lambda *_: None)
    monkeypatch.setattr("study.pictures.style.save_png", lambda _, path: path)
    folders = [
        Path(tool.json("walk", *line.split())["pictures"]["strip"]).parent.name
        for line in ("", "--before published", "--before reference")
    ]
    assert len(set(folders)) == 3


def test_a_store_without_the_motors_energy_says_so(walk, tool, tmp_path):
    """As version 0.3 made stores: the muscles' energy counts then, and a line says it."""
    store = tmp_path / "store"
    old = tmp_path / "old.parquet"
    fake_walker.write_plain_store(store)
    opened = open_store(store)
    table = opened.table().drop_columns([ENERGY])
    columns = {"columns": columns_of(table.schema), "code_version": "0.2.0"}
    specification = opened.specification | columns
    footer = opened.footers[0] | {
        "rows": len(table),
        "specification": specification,
        "specification_hash": document_hash(specification),
    }
    write_table(old, table, footer)

    def gains(*words):
        return tool.json("walk", "--speed", 1.1, "--out", tmp_path / "out", *words)[
            "gains"
        ]

    both = gains("--store", store)
    muscles = gains("--store", store, "--least", OF_MUSCLES)
    for least, found in ((ENERGY, both), (OF_MUSCLES, muscles)):
        row = row_at_speed(store, 1.1, least)
        assert found == gains_of_row(store, row).as_document()
    assert muscles != both and "lacks" not in tool.err
    assert (
        tool.err == "warning: speed: the row has 1.1 m/s in the store, and 0.97 here\n"
    )
    assert gains("--store", old) == muscles
    assert tool.err.startswith(f"warning: {old} lacks {ENERGY}, ")
    assert tool.err.count("\n") == 2


def test_the_front_of_a_store_is_listed(tmp_path, tool, simulator):
    experiment = front(tmp_path)
    words = ("walk", "--front", "--store", experiment.stores["worlds"])
    config = ("--config", tmp_path / "kept" / "toy.toml")
    rows = tool.json(*words, *config)
    assert tool(*words, *config) == 0
    head, *lines = tool.out.splitlines()
    assert head.split() == ["row", "effort", "slow"] and len(lines) == len(rows) > 2
    assert [int(line.split()[0]) for line in lines] == [row["row"] for row in rows]
    tool.refuses("front: 'flat' .* two goals", *words, "--config", FLAT)
    tool.refuses("store: None .* lists rows", "walk", "--front", *config)


def test_of_several_speeds_each_has_its_part_of_the_walk(walk, tmp_path):
    store = tmp_path / "store"
    fake_walker.write_plain_store(store)
    slow, fast = (
        gains_of_row(store, row_at_speed(store, speed)) for speed in (0.95, 1.1)
    )
    shown = walk("--store", store, "--speed", 0.95, "--speed", 1.1, "--duration", 12)
    call = fake_walker.calls[-1]
    (switch,) = call["switches"]
    assert shown["gains"] == slow.as_document() and (call["gains"] == slow.gains).all()
    assert switch.at_s == 6.0 and (switch.gains == fast.gains).all()


@pytest.mark.parametrize(
    ("words", "seed", "run"),
    [("", None, 0), ("--run 3", None, 3), ("--seed 523001", 523001, 0)],
)
def test_a_run_and_a_seed_have_their_own_body_and_ground(walk, words, seed, run):
    walk("--config", "rough8", *words.split())
    experiment = read_experiment(ROUGH8, seed=seed)
    call = fake_walker.calls[-1]
    assert call["terrains"].height(50.0) == experiment.terrain(run).height(50.0)
    assert call["bodies"].mass_kg.tolist() == experiment.body(run).mass_kg.tolist()


WORLD = """
[body.mass]
thigh_left = 1.5
[world.muscles]
SOL_left = 0.5
[world.prosthesis]
side = "right"
stiffness_nmprad = 300
damping_nmsprad = 1
"""


@pytest.mark.slow
def test_the_world_of_the_walk_is_in_the_files_of_other_programs(tmp_path, tool):
    config = tmp_path / "weak.toml"
    config.write_text(FLAT.read_text() + WORLD)
    folder = tmp_path / "opensim"
    states = tmp_path / "walk.sto"
    model = tmp_path / "new" / "walker.xml"
    words = (
        f"walk --config {config} --duration 1 --movie-seconds 0 --out {tmp_path}/out"
    )
    files = f"--opensim {folder} --trajectory {states} --mjcf {model}"
    assert tool(*words.split(), *files.split()) == 0
    osim = ElementTree.parse(folder / "walker.osim")
    strongest = {
        muscle.get("name"): float(muscle.findtext("max_isometric_force", "nan"))
        for muscle in osim.iter("Millard2012EquilibriumMuscle")
    }
    assert len(strongest) == 11 and strongest["soleus_l"] == 2000.0
    assert strongest["hamstrings_l"] == strongest["hamstrings_r"] == 3000.0
    assert not {"soleus_r", "tib_ant_r", "gastroc_r"} & set(strongest)
    (femur,) = [body for body in osim.iter("Body") if body.get("name") == "femur_l"]
    assert float(femur.findtext("mass", "nan")) == 1.5 * 8.5
    (spring,) = osim.iter("SpringGeneralizedForce")
    assert spring.findtext("coordinate") == "ankle_angle_r"
    names = states.read_text().partition("endheader\n")[2].split()
    assert "/forceset/soleus_l/activation" in names
    assert "/forceset/soleus_r/activation" not in names
    opened = mujoco.MjModel.from_xml_path(str(model))
    assert opened.joint("foot_r").stiffness == 300.0 and opened.ntendon == 11
