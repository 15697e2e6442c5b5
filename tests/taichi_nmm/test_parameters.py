"""The table of gains: names, order, bounds; gains from arrays and files."""

import json

import numpy as np
import pytest

from taichi_nmm import (
    PUBLISHED_GAINS,
    load_all_gains,
    load_gains,
    parameters,
)
from taichi_nmm.parameters import (
    DEVICE,
    GAIN_NAMES,
    GAINS,
    LOW_LEVEL_GAINS,
    LOW_LEVEL_NAMES,
    check_gains,
)
from tests.cases import asset, refused

IN_THE_PAPERS_ORDER = (
    "K_GAS K_GLU K_HAM K_SOL K_TA_SOL K_TA K_VAS Kp_stance Kd_stance K_mix_GLU "
    "Kp_swing Kd_swing alpha_0 C_d C_v l_clr"
)


def test_names_are_in_the_papers_order_and_bounds_those_of_the_specification():
    assert " ".join(GAIN_NAMES) == IN_THE_PAPERS_ORDER
    assert (
        LOW_LEVEL_NAMES[7] == "theta_ref"
        and len(LOW_LEVEL_NAMES) == 8 + len(DEVICE) + 16
    )
    assert LOW_LEVEL_NAMES[-16:] == tuple(f"{name}_asymmetry" for name in GAIN_NAMES)
    assert DEVICE[0].default == DEVICE[0].low == 0.0  # no torque
    assert not set(LOW_LEVEL_NAMES) & set(GAIN_NAMES)
    for group in (GAINS, [each for each in LOW_LEVEL_GAINS if each != DEVICE[0]]):
        default = np.array([parameter.default for parameter in group])
        assert np.all(np.array([each.low for each in group]) < default)
        assert np.all(default < np.array([each.high for each in group]))
        assert all(p.unit and p.meaning and p.source for p in group)
    high = [8, 3, 3, 24, 8, 9, 8, 9, 2, 3.5, 300, 45, np.deg2rad(92), 0.5, 0.5, 0.99]
    low = [0] * 10 + [5, 0, np.deg2rad(55), 0, 0, 0.55]
    np.testing.assert_allclose(parameters.upper_bounds(), high)
    np.testing.assert_allclose(parameters.lower_bounds(), low)


def test_gains_become_rows_even_outside_the_bounds():
    np.testing.assert_array_equal(
        parameters.gain_rows(PUBLISHED_GAINS), PUBLISHED_GAINS[None]
    )
    single = np.tile(PUBLISHED_GAINS, (5, 1)).astype(np.float32)
    assert parameters.gain_rows(single).dtype == np.float64
    large = 10.0 * PUBLISHED_GAINS
    np.testing.assert_allclose(parameters.gain_rows(large)[0], large)


def spoilt(value):
    rows = np.tile(PUBLISHED_GAINS, (3, 1))
    rows[2, 12] = value
    return rows


@pytest.mark.parametrize(
    ("values", "message"),
    [
        *(
            (np.ones(shape), r"gains\.shape")
            for shape in ((15,), (3, 17), (2, 2, 16), ())
        ),
        *(
            (spoilt(value), r"gains\[2\]\.alpha_0: .*a finite number")
            for value in (np.nan, np.inf, -np.inf)
        ),
        *(
            (values, "gains")
            for values in ("published", [["x"] * 16], [[1.0] * 16, [1.0]], None)
        ),
    ],
)
def test_rows_that_cannot_be_used_are_named(values, message):
    with refused(f"^{message}"):
        parameters.gain_rows(values)
    with refused(r"low_level_gains\.shape.*\[n, 28\]"):
        parameters.gain_rows(np.ones((2, 16)), LOW_LEVEL_GAINS, "low_level_gains")


def test_the_published_gains_are_loaded_by_name_as_a_copy():
    loaded = load_gains("published")
    np.testing.assert_array_equal(loaded, PUBLISHED_GAINS)
    loaded[:] = 0.0
    assert np.all(load_gains("published") == PUBLISHED_GAINS)


def test_shipped_gains_lie_inside_the_bounds():
    files = list(parameters.NAMED_GAINS_DIRECTORY.glob("*.json"))
    assert files
    for file in files:
        loaded = load_gains(file.stem)
        assert np.all(
            (parameters.lower_bounds() <= loaded)
            & (loaded <= parameters.upper_bounds())
        )


def test_gains_come_back_in_any_order(tmp_path):
    path = tmp_path / "mine.json"
    for gains in (
        PUBLISHED_GAINS,
        parameters.lower_bounds(),
        parameters.upper_bounds(),
    ):
        named = list(zip(GAIN_NAMES, gains.tolist(), strict=True))
        path.write_text(json.dumps(dict(reversed(named))))
        np.testing.assert_array_equal(load_gains(str(path)), gains)


def gains_text(**changes):
    """A file of the published gains with some values changed; None leaves the name out."""
    data = {**dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True)), **changes}
    return json.dumps(
        {name: value for name, value in data.items() if value is not None}
    )


@pytest.mark.parametrize("case", asset("bad-gains.toml").values())
def test_files_and_names_of_no_gains_are_refused(case, tmp_path):
    path = tmp_path / "bad.json"
    path.write_text(case.get("text") or gains_text(**case["changes"]))
    load = load_all_gains if case.get("low_level") else load_gains
    with refused(case["message"]):
        load(case.get("source", str(path)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"C_d": None}, r"gains\.C_d: None"),
        ({"K_SOL": 10**400}, r"gains\.K_SOL: 10.*0 to 24"),
    ],
)
def test_values_of_gains_that_no_table_has_are_refused(changes, message, tmp_path):
    path = tmp_path / "bad.json"
    path.write_text(gains_text(**changes))
    with refused(message):
        load_gains(str(path))


DEFAULTS = np.array([parameter.default for parameter in LOW_LEVEL_GAINS])


def test_low_level_gains_have_defaults_and_a_file_may_name_them(tmp_path):
    for name in ("published", "reference"):
        gains, low_level = load_all_gains(name)
        np.testing.assert_array_equal(gains, load_gains(name))
        np.testing.assert_array_equal(low_level, DEFAULTS)
    path = tmp_path / "more.json"
    path.write_text(gains_text(theta_ref=0.2, k_ext=0))
    gains, low_level = load_all_gains(str(path))
    np.testing.assert_array_equal(gains, PUBLISHED_GAINS)
    changed = {
        LOW_LEVEL_NAMES[i]: low_level[i] for i in np.flatnonzero(low_level != DEFAULTS)
    }
    assert changed == {"theta_ref": 0.2, "k_ext": 0.0}


def test_low_level_gains_are_checked_under_the_field_of_a_caller():
    values = dict(zip(LOW_LEVEL_NAMES, DEFAULTS.tolist(), strict=True))
    np.testing.assert_array_equal(check_gains(values, LOW_LEVEL_GAINS), DEFAULTS)
    with refused(r"^best\.k_ext: -1"):
        check_gains(values | {"k_ext": -1}, LOW_LEVEL_GAINS, "best")
