"""The figures of validate: what holds, and how they are printed."""

import json

import pytest

from study.commands.validate import Figure, show

FIGURES = (
    Figure("speed", 1.4, 1.365, 1.425, "m/s"), Figure("tick", 250.0, 0, 200, "us"),
    Figure("steps a second", 50_000.0, low=45_000), Figure("alive", 10.1, unit="%"),
)  # fmt: skip


def test_figures_are_a_table_or_one_list(capsys: pytest.CaptureFixture[str]) -> None:
    show(iter(FIGURES), "20 points", as_json=False)
    head, _, *table = capsys.readouterr().out.splitlines()
    assert head.startswith("20 points; 20") and "Python 3." in head
    assert table == [
        "| what | measured | bar | holds |",
        "|---|---|---|---|",
        "| speed | 1.4 m/s | 1.365 to 1.425 | yes |",
        "| tick | 250 us | 0 to 200 | **no** |",
        "| steps a second | 5e+04  | 45000 | yes |",
        "| alive | 10.1 % | | |",
    ]
    show(iter(FIGURES), "20 points", as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert [each["what"] for each in found] == [figure.what for figure in FIGURES]
    assert [each["holds"] for each in found] == [True, False, True, True]
    assert found[3]["low"] is None
