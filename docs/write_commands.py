"""Write docs/commands.md from the commands' own --help.

    python docs/write_commands.py

`tests/test_docs.py` fails when the page is not what this writes.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from study.options import COMMANDS, parser_of  # noqa: E402

PAGE = ROOT / "docs" / "commands.md"
INTRODUCTION = (ROOT / "docs" / "commands-introduction.txt").read_text(encoding="utf-8")


def page() -> str:
    """The whole page."""
    return "\n".join(
        [INTRODUCTION, *(line for name in COMMANDS for line in chapter(name))]
    )


def chapter(name: str) -> Iterator[str]:
    """A command: its first sentence, the rest of its description, its own options."""
    parser = parser_of(name)
    first, _, rest = (parser.description or "").strip().partition("\n")
    yield from (f"## {name}", first, "", "```text", rest.strip("\n"), "```", "")
    yield from ("| option | meaning |", "|---|---|")
    for action in parser._actions:
        if not isinstance(action, argparse._HelpAction):
            meaning = (action.help or "") % vars(action)
            row = f"| `{words(action)}` | {cell(meaning)} |"
            if row not in INTRODUCTION:
                yield row
    yield ""


def words(action: argparse.Action) -> str:
    """An option with the name of its value, or the name of a positional argument."""
    value = str(action.metavar or "")
    if action.choices is not None and not value:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    return cell(
        " ".join(filter(None, [", ".join(action.option_strings), value])) or action.dest
    )


def cell(text: str) -> str:
    """Text that does not end a cell of a table."""
    return " ".join(text.split()).replace("|", r"\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.relative_to(ROOT))
