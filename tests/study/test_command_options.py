"""Options that nobody knows or that lack a value: one line, whatever they are."""

import sys

import pytest

from study.command_options import Options
from study.shipped import config_path
from taichi_nmm.errors import InputError


@pytest.mark.parametrize(
    "word", ["--a\nb", "--\x1b[31m", "--\udcff", "--a\u2028b", "--" + "x" * 9999]
)
def test_an_unknown_option_is_one_printable_line(
    word: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["taichi-nmm", word])
    with pytest.raises(SystemExit, check=lambda end: end.code == 2):
        Options(__file__).parse_args()
    said = capsys.readouterr().err
    assert said.startswith("error: unrecognized arguments: --") and said.count("\n") == 1
    assert said.removesuffix("\n").isprintable() and len(said) < 600


def test_two_dashes_are_no_value(monkeypatch: pytest.MonkeyPatch) -> None:
    options = Options(__file__)
    options.add_argument("--run", type=int)
    monkeypatch.setattr(sys, "argv", ["taichi-nmm", "--run=--"])
    with pytest.raises(InputError, match="run: '--' cannot be used"):
        options.parse_args()


def test_a_configuration_of_a_name_that_no_file_can_have() -> None:
    assert str(config_path("x" * 5000)) == "x" * 5000
