"""The command line: help is quick and complete; words that nobody means to type are one line."""

import subprocess
import sys

import pytest

from study.cli import main
from study.options import COMMANDS, Options, config_path, parser_of
from tests.cases import refused

SLOW_TO_LOAD = (
    "taichi",
    "quadrants",
    "matplotlib",
    "optuna",
    "pyarrow",
    "scipy",
    "sklearn",
)
QUICK = [
    ["--help"],
    [],
    *([name, "--help"] for name in COMMANDS),
    ["walk", "--list-configs"],
]


@pytest.mark.slow
def test_help_and_import_load_nothing_that_is_slow():
    code = f"""
import sys
import study, taichi_nmm.conditions, taichi_nmm.kernel.layout
from storage.pool import cores
from study import cli
from study.cli import main
for words in {QUICK!r}:
    try:
        main(words)
    except SystemExit as end:
        assert not end.code, (words, end.code)
    found = set(sys.modules) & set({SLOW_TO_LOAD!r})
    assert not found, (words, found)
"""
    done = subprocess.run(
        [sys.executable, "-OO", "-c", code], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("usage: ") == len(QUICK) - 1


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_of_a_command_is_described(name):
    parser = parser_of(name)
    assert parser.prog == f"taichi-nmm {name}"
    assert (parser.description or "").partition("\n")[0].endswith(".")
    assert len(parser._actions) > 1
    assert all(action.help for action in parser._actions)


def test_an_unknown_command_is_one_line_that_lists_them(
    capsys,
):
    with pytest.raises(SystemExit, check=lambda end: end.code == 2):
        main(["wlak"])
    line = f"error: command: 'wlak' cannot be used; allowed: {', '.join(COMMANDS)}\n"
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("word", ["a\nb", "\x1b[31m", "\udcff", "a\u2028b", "x" * 9999])
def test_an_unknown_option_is_one_safe_line(word, capsys):
    with pytest.raises(SystemExit, check=lambda end: end.code == 2):
        Options(__file__).parse_args([f"--{word}"])
    said = capsys.readouterr().err
    assert (
        said.startswith("error: unrecognized arguments: --") and said.count("\n") == 1
    )
    assert said.removesuffix("\n").isprintable() and len(said) < 600


def test_two_dashes_are_no_value_and_a_configuration_may_have_a_name_that_no_file_can():
    options = Options(__file__)
    options.add_argument("--run", type=int)
    with refused("run: '--' cannot be used"):
        options.parse_args(["--run=--"])
    assert str(config_path("x" * 5000)) == "x" * 5000


@pytest.mark.parametrize(
    "words", ["--nothing -- next", "--foo --bar next", "--a --a next"]
)
def test_names_that_no_bench_has_are_one_line(
    words,
    monkeypatch,
    capsys,
    tmp_path,
):
    """Also where a name stands in the place of another one's number."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["bench", *words.split(), "--bench", "walk.toml"])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("error: ") == 1
