"""Settings of MuJoCo: what is refused, and that documents of the other engine stay as they were."""

import importlib.util
import pickle
from pathlib import Path
from typing import Any

import pytest

import taichi_nmm
from taichi_nmm import mujoco_engine
from taichi_nmm.conditions import Conditions, read_conditions
from taichi_nmm.config import Table, read_toml
from taichi_nmm.errors import InputError
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.settings import MujocoSettings, Settings

NAN, INF = float("nan"), float("inf")
ON_MUJOCO: dict[str, Any] = {"engine": "mujoco", "duration_s": 20.0}


def read(simulation: dict[str, Any]) -> Conditions:
    table = Table({"simulation": simulation})
    conditions = read_conditions(table, duration_s=5.0, shortest_s=1.0, longest_s=100.0)
    table.done()
    return conditions


def refused(field: str, simulation: dict[str, Any]) -> str:
    """The one line about a field."""
    with pytest.raises(InputError) as caught:
        read(simulation)
    assert caught.value.field == field
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_defaults_are_mujocos_own_contact_and_this_simulators_stops() -> None:
    conditions = read(ON_MUJOCO)
    assert conditions.settings.mujoco == MujocoSettings(0.02, 1.0, "stops")
    assert conditions.settings.engine == "mujoco"
    assert read({}).settings.engine == "taichi"


@pytest.mark.parametrize("engine", ["bullet", "MuJoCo", "", 1])
def test_an_unknown_engine(engine: object) -> None:
    assert "taichi" in (line := refused("simulation.engine", {"engine": engine})) or "text" in line
    if isinstance(engine, str):
        with pytest.raises(InputError, match=r"^simulation\.engine: .* taichi or mujoco$"):
            Settings(engine=engine)


@pytest.mark.parametrize("value", [0.0, -0.02, NAN, INF, -INF])
@pytest.mark.parametrize("name", ["time_constant_s", "damping_ratio"])
def test_contact_numbers_that_mean_something_else(name: str, value: float) -> None:
    """Negative ones are MuJoCo's direct form, of other units."""
    with pytest.raises(InputError, match=rf"^simulation\.mujoco\.{name}: ") as caught:
        MujocoSettings(**{name: value})
    assert "\n" not in str(caught.value)
    refused(f"simulation.mujoco.{name}", ON_MUJOCO | {"mujoco": {name: value}})


@pytest.mark.parametrize("name", ["time_constant_s", "damping_ratio", "limits"])
def test_values_of_another_type(name: str) -> None:
    value = "soft" if name != "limits" else 1
    refused(f"simulation.mujoco.{name}", ON_MUJOCO | {"mujoco": {name: value}})


@pytest.mark.parametrize(
    ("step_s", "shortest_s"), [(1e-3, 5e-3), (0.5e-3, 2.5e-3), (0.25e-3, 1.25e-3)]
)
def test_a_time_constant_of_some_steps_only(step_s: float, shortest_s: float) -> None:
    own = {"time_constant_s": shortest_s * 0.99}
    line = refused(
        "simulation.mujoco.time_constant_s", ON_MUJOCO | {"physics_step_s": step_s, "mujoco": own}
    )
    assert f"{shortest_s:g} or more" in line and "physics_step_s smaller" in line
    shortest = MujocoSettings(time_constant_s=shortest_s)
    assert Settings(engine="mujoco", physics_step_s=step_s, mujoco=shortest).mujoco == shortest


@pytest.mark.parametrize("limits", ["none", "Stops", ""])
def test_limits_of_another_name(limits: str) -> None:
    line = refused("simulation.mujoco.limits", ON_MUJOCO | {"mujoco": {"limits": limits}})
    assert line.endswith("stops or mujoco")


@pytest.mark.parametrize("arch", ["cuda", "vulkan"])
def test_no_graphics_card(arch: str) -> None:
    assert "auto or cpu" in refused("simulation.arch", ON_MUJOCO | {"arch": arch})
    for usable in ("auto", "cpu"):
        assert read(ON_MUJOCO | {"arch": usable}).settings.arch == usable


def test_keys_that_the_engine_has_not() -> None:
    refused("simulation.mujoco.solimp", ON_MUJOCO | {"mujoco": {"solimp": 0.9}})
    refused("simulation.contact_relaxation_speed_mps",
            ON_MUJOCO | {"contact_relaxation_speed_mps": 0.1})  # fmt: skip
    for engine in ({}, {"engine": "taichi"}):
        refused("simulation.mujoco", engine | {"mujoco": {"time_constant_s": 0.01}})


@pytest.mark.parametrize("missing", ["mujoco", "mujoco.batch"])
def test_mujoco_is_not_installed_or_too_old(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    def find_spec(name: str, *_: Any) -> Any:
        return None if name == missing else importlib.util.find_spec(name)

    monkeypatch.setattr(mujoco_engine, "find_spec", find_spec)
    says = r"^simulation\.engine: 'mujoco' .* 4\.0 or newer: pip install 'taichi-nmm\[mujoco\]'$"
    with pytest.raises(InputError, match=says) as caught:
        require_mujoco()
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=says):
        taichi_nmm.simulate(PUBLISHED_GAINS, settings=Settings(engine="mujoco"))


# Documents.


def test_what_decides_a_walk_is_in_the_document_and_comes_back() -> None:
    own = {"time_constant_s": 0.005, "damping_ratio": 0.8, "limits": "mujoco"}
    conditions = read(ON_MUJOCO | {"physics_step_s": 0.5e-3, "mujoco": own, "arch": "cpu"})
    document = conditions.simulation_document()
    assert document == {
        "duration_s": 20.0, "physics_step_s": 0.5e-3, "precision": "float32",
        "engine": "mujoco", "mujoco": own,
    }  # fmt: skip
    again = read(document)
    assert again.simulation_document() == document
    assert again.settings.mujoco == conditions.settings.mujoco
    assert pickle.loads(pickle.dumps(conditions)) == conditions
    assert hash(pickle.loads(pickle.dumps(conditions))) == hash(conditions)


def test_the_document_of_the_other_engine_is_as_before() -> None:
    """Stores and folders of before there were two engines hash it, in this order."""
    for simulation in ({}, {"engine": "taichi"}):
        document = read(simulation).simulation_document()
        assert list(document.items()) == [
            ("duration_s", 5.0), ("physics_step_s", 1e-3),
            ("contact_relaxation_speed_mps", 0.1), ("precision", "float32"),
        ]  # fmt: skip


def test_configurations_with_three_contacts() -> None:
    """MuJoCo's default, half of it, and a quarter at half the step; all else is equal."""
    configs = Path(__file__).resolve().parents[3] / "configs"
    contacts = {"soft": (0.02, 1e-3), "middle": (0.01, 1e-3), "hard": (0.005, 0.5e-3)}
    grounds = {path.stem for path in configs.glob("mujoco-*.toml")}
    assert len(grounds) == 5
    for ground in grounds:
        others = []
        for contact, (time_constant_s, step_s) in contacts.items():
            table = read_toml(configs / f"{ground}-{contact}.toml")
            data = {key: table.unread[key] for key in table.unread}
            simulation = dict(data.pop("simulation"))
            assert simulation.pop("mujoco") == {"time_constant_s": time_constant_s}
            assert simulation.pop("physics_step_s") == step_s
            assert simulation["engine"] == "mujoco" and data.pop("name") == f"{ground}-{contact}"
            assert data["runs"] == 50 and data["trials"] == 40 and data["until_walker"] is True
            others.append((data, simulation))
        assert others[0] == others[1] == others[2]
