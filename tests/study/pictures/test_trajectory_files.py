"""A walk as a file: read back, every number is the recorded one, and the header says what it is."""

from dataclasses import replace

import numpy as np
import pytest

from study.pictures import trajectory_files
from study.pictures.stick_figure import leg, trunk
from study.pictures.trajectory_files import require_trajectory_file, write_trajectory
from taichi_nmm.result import MUSCLES
from tests.cases import refused
from tests.study import synthetic_gait

WALK = synthetic_gait.walk(2.0, 100.0)


def read_storage(text):
    """Keys and columns of OpenSim's format, as its own reader takes them."""
    head, _, body = text.partition("endheader\n")
    keys = dict(line.split("=", 1) for line in head.splitlines() if "=" in line)
    names, *rows = [line.split("\t") for line in body.splitlines()]
    assert int(keys["nColumns"]) == len(names) and int(keys["nRows"]) == len(rows)
    return keys, dict(zip(names, np.array(rows, dtype=float).T, strict=True))


def test_coordinates_in_opensims_signs(tmp_path):
    write_trajectory(tmp_path / "walk.mot", WALK, "a walk")
    text = (tmp_path / "walk.mot").read_text()
    keys, columns = read_storage(text)
    assert text.startswith("a walk\nversion=1\n") and keys["inDegrees"] == "yes"
    assert "Angles are in degrees" in text and "Units are S.I. units" in text
    np.testing.assert_array_equal(columns["time"], WALK.time_s)
    # Ours: extension, flexion, plantarflexion positive; left, then right.
    hip, _, _, _, knee, ankle = np.rad2deg(WALK.joint_rad).T
    expected = {
        "pelvis_tx": WALK.q[:, 0],
        "pelvis_tilt": -np.rad2deg(WALK.q[:, 2]),
        "hip_flexion_l": -hip,
        "knee_angle_r": -knee,
        "ankle_angle_r": -ankle,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(columns[name], values, atol=1e-12)


def test_states_by_the_paths_of_opensim_4(tmp_path):
    write_trajectory(tmp_path / "walk.sto", WALK)
    keys, columns = read_storage((tmp_path / "walk.sto").read_text())
    assert keys["inDegrees"] == "no"
    vastus, soleus = MUSCLES.index("VAS"), MUSCLES.index("SOL")
    np.testing.assert_array_equal(
        columns["/forceset/vasti_r/activation"],
        WALK.activation[:, len(MUSCLES) + vastus],
    )
    np.testing.assert_array_equal(
        columns["/forceset/soleus_l/fiber_length"], WALK.fibre_length_m[:, soleus]
    )
    speed = columns["/jointset/knee_l/knee_angle_l/speed"]
    np.testing.assert_array_equal(speed, WALK.qdot[:, 3] - WALK.qdot[:, 4])
    assert len(columns) == 1 + 2 * 9 + 2 * 2 * len(MUSCLES)


def test_csv_has_all_samples_by_names_with_units(tmp_path):
    write_trajectory(tmp_path / "walk.csv", WALK)
    text = (tmp_path / "walk.csv").read_text()
    names, *rows = [line.split(",") for line in text.splitlines()]
    table = np.array(rows, dtype=float)
    fields = [
        "q",
        "qdot",
        "joint_rad",
        "activation",
        "muscle_force_n",
        "ground_force_n",
        "stance",
        "joint_torque_nm",
        "swing_torque_nm",
        "device_torque_nm",
        "push_n",
        "fibre_length_m",
        "fibre_velocity_mps",
        "delayed",
    ]
    wide = [WALK.time_s[:, None], *(getattr(WALK, field) for field in fields)]
    count = sum(values.shape[1] for values in wide)
    np.testing.assert_array_equal(table[:, :count], np.hstack(wide))
    assert len(set(names)) == table.shape[1]
    assert {name.rpartition("_")[2] for name in names[count:]} == {"w"}  # powers
    known = {"time_s", "x_m", "thigh_l_rad", "r_knee_flexion_rad", "l_SOL_force_n"}
    assert known <= set(names)


def test_markers_of_motion_capture_read_back(tmp_path):
    ezc3d = pytest.importorskip(
        "ezc3d", reason="no ezc3d: pip install 'taichi-nmm[c3d]'"
    )
    write_trajectory(tmp_path / "walk.c3d", WALK)
    read = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    about, (x, y, z, _) = read["parameters"]["POINT"], read["data"]["points"]
    assert about["UNITS"]["value"] == ["mm"] and about["RATE"]["value"] == [100.0]
    assert about["LABELS"]["value"] == trajectory_files.MARKERS and not y.any()
    found_mm = dict(
        zip(trajectory_files.MARKERS, np.stack([x, z], axis=2), strict=True)
    )
    shoulder, _ = trunk(WALK.q)
    expected_m = {
        "SHOULDER": shoulder,
        "HIP": WALK.q[:, :2],
        "L_HEEL": leg(WALK.q, 0).heel,
        "R_BALL": leg(WALK.q, 1).ball,
    }
    for name, place_m in expected_m.items():
        np.testing.assert_allclose(found_mm[name], 1e3 * place_m, atol=1e-3)
    long = replace(WALK, q=np.zeros((65536, 9)), time_s=np.arange(1, 65537) / 100.0)
    with refused("trajectory: 'walk.c3d' .*65535 samples"):
        write_trajectory(tmp_path / "walk.c3d", long)


def test_a_file_that_cannot_be_written(tmp_path, monkeypatch):
    for name in ("walk.txt", "walk", "walk.MOT"):
        with refused(r"trajectory: .*\.csv, \.c3d, \.mot, \.sto"):
            require_trajectory_file(tmp_path / name)
    (tmp_path / "file").write_text("")
    with refused("trajectory: "):
        require_trajectory_file(tmp_path / "file" / "walk.mot")
    require_trajectory_file(tmp_path / "new" / "walk.mot")
    monkeypatch.setattr(trajectory_files, "find_spec", lambda name: None)
    with refused(r"trajectory: '\.c3d' .*taichi-nmm\[c3d\]"):
        require_trajectory_file(tmp_path / "walk.c3d")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]
