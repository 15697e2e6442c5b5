"""Settings of a simulation: defaults and ranges."""

from dataclasses import fields

import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.settings import PHYSICS_STEPS_S, Settings


def test_defaults_are_those_the_gaits_converge_with() -> None:
    settings = Settings()
    assert settings.physics_step_s == 1e-3
    assert settings.contact_relaxation_speed_mps == 0.10
    assert settings.precision == "float32"
    assert settings.threads is None


@pytest.mark.parametrize(("step_s", "substeps"), [*zip(PHYSICS_STEPS_S, (1, 2, 4), strict=True)])
def test_physics_steps_fill_a_control_tick(step_s: float, substeps: int) -> None:
    assert Settings(physics_step_s=step_s).substeps == substeps


def test_the_published_contact_speed_is_allowed() -> None:
    assert Settings(contact_relaxation_speed_mps=0.03).contact_relaxation_speed_mps == 0.03


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("physics_step_s", 2e-3),
        ("physics_step_s", float("nan")),
        ("contact_relaxation_speed_mps", 0.0),
        ("contact_relaxation_speed_mps", 11.0),
        ("contact_relaxation_speed_mps", float("nan")),
        ("precision", "float16"),
        ("arch", "tpu"),
        ("threads", 0),
        ("threads", 10_000),
    ],
)
def test_settings_out_of_range_are_named(field: str, value: object) -> None:
    with pytest.raises(InputError) as caught:
        Settings(**{field: value})  # type: ignore[arg-type]
    assert caught.value.field == f"simulation.{field}"
    assert "\n" not in str(caught.value)


def test_every_setting_but_the_machines_is_in_the_document() -> None:
    document = Settings(precision="float64", arch="cpu", threads=1).document()
    names = [field.name for field in fields(Settings)]
    left_out = ("arch", "threads", "engine", "mujoco")  # of another engine: its own test
    assert list(document) == [name for name in names if name not in left_out]
    assert document["precision"] == "float64"
