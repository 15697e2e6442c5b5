"""What nobody means to type, in every option of every command: one line, exit code 2, no file."""

from argparse import Action
from pathlib import Path

import pytest

import taichi_nmm
from study.cli import main
from study.options import COMMANDS, config_path, parser_of
from tests.cases import asset
from tests.study import fake_walker
from tests.tools.running import run_tool

WORDS = {
    "300 letters": "x" * 300,
    "5,000 digits": "9" * 5000,
    "10^400": str(10**400),
    "NUL": "nul\0",
    "newline": "new\nline",
    "surrogate": "\udcff",
    "escape": "\x1b[31m",
    "empty path of a thousand folders": "x/" * 3000,
}
DEEP = {
    "deep.json": '{"a":' * 100_000,
    "digits.json": f'{{"K_SOL": {"9" * 5000}}}',
    "power.json": f'{{"K_SOL": 1{"0" * 400}}}',
    "deep.toml": "a = " + "[" * 100_000,
    "digits.toml": f"seed = {'9' * 5000}",
    "power.toml": f"seed = 1{'0' * 400}",
}
NEW_FILE = {"walk": "--mjcf"}
COMPLETE, BESIDE, FORMS = asset("wild-arguments.toml").values()


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """A configuration with its store, a finished comparison, and files that nobody should read."""
    folder = tmp_path_factory.mktemp("places")
    places = {name: folder / name for name in DEEP}
    for name, text in DEEP.items():
        places[name].write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        places["CONFIG"] = fake_walker.write_config(folder)
        short = "--arms random --runs 1 --trials 1 --workers 1"
        line = f"compare --config {places['CONFIG']} --out {folder / 'done'} {short}"
        assert run_tool(patch, *line.split()) == 0
    return places | {"STORE": folder / "store", "DONE": folder / "done"}


def tries(command, action, is_whole, places):
    """What is tried with an option: what it is called, and all words of the command."""
    flag = action.option_strings[-1] if action.option_strings else ""
    of_text = action.type in (None, Path, config_path) and not is_whole
    is_text = of_text and action.choices is None
    words = WORDS if is_text else {"5,000 digits": WORDS["5,000 digits"]}
    if is_text and NEW_FILE.get(command) != flag:
        words = words | {name: str(places[name]) for name in DEEP}
    beside = BESIDE.get(flag, ()) if command == "walk" else ()
    before = [
        str(places.get(word, word)) for word in (*COMPLETE.get(command, ()), *beside)
    ]
    for name, word in words.items():
        for form in FORMS.get(flag, ("{}",)):
            tried = form.format(word)
            said = f"{flag or action.dest} {form}: {name}"
            yield said, [*before, f"{flag}={tried}"] if flag else [tried]


def refuse_work(*_, **__):
    raise AssertionError("it went on to work")


def is_safe(said, of_a_file):
    """One line that can be printed; of a file's mistakes a line each."""
    lines = said.removesuffix("\n").split("\n")
    if len(lines) > 1 and not of_a_file:
        return False
    return all(line.startswith("error: ") and line.isprintable() for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_it_is_refused_in_one_line(command, places, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(vars(taichi_nmm), "simulate", refuse_work)
    monkeypatch.setattr("socketserver.BaseServer.serve_forever", refuse_work)
    tried, wrong = 0, []
    parser = parser_of(command)
    actions = [action for action in parser._actions if action.nargs != 0]
    for action in [*actions, Action(["--new\nline"], "unknown")]:
        for name, words in tries(command, action, action.dest in parser.bounds, places):
            tried += 1
            try:
                main([command, *words])
                code = None
            except SystemExit as end:
                code = end.code
            except BaseException as error:
                code = f"{type(error).__name__}: {error}"[:150]
            said = capsys.readouterr()
            if code != 2 or said.out or not is_safe(said.err, name.endswith(".toml")):
                wrong.append(f"{name}: {code}; {said.err[:150]!r}")
            if left := [path.name for path in tmp_path.iterdir()]:
                wrong.append(f"{name}: left {left}")
                break
    assert tried >= len(WORDS)
    assert not wrong, f"{len(wrong)} of {tried}:\n" + "\n".join(wrong)
