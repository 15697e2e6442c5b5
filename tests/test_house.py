"""The house of CONTRIBUTING.md: who may know whom, no circles, no long file, no silent field.

Read from the source alone, so that nothing is imported. A function's imports count;
those under `if TYPE_CHECKING` do not.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("taichi_nmm", "storage", "study")
OURS = (*PACKAGES, "tools")
HUB = (
    ROOT / "study" / "hub"
)  # a package of another registry, of which no module is imported
MOST_LINES = 600
# The budget of CONTRIBUTING.md, in nodes of the syntax tree: neither width nor
# docstrings nor comments change it. The hub's package counts; the tests do not count as
# product.
MOST_NODES_OF_PRODUCT = 275_000
MOST_NODES_OF_TESTS = 266_000
LEAST_DOCUMENTED = 0.95  # of the fields that users hold
DOOR = "taichi_nmm.__main__"  # of the commands: the one module that looks up
COMMANDS = ("tools", "study.commands")

# A part of the house, and all that it may import of this project.
ALLOWED = {
    # The floor: what says no to a user.
    "storage.inputs": ("storage.inputs",),
    # The walker: one simulator among others, which a store need not know.
    "taichi_nmm": ("taichi_nmm", "storage.inputs"),
    "storage": ("storage",),
    "study": PACKAGES,
    "study.experiment": (
        "study.experiment",
        "study.sampler",
        "study.pictures",
        "storage",
        "taichi_nmm",
    ),
    "study.experiment.features": (
        "study.experiment.objective",
        "study.sampler",
        "storage",
        "taichi_nmm",
    ),
    "study.experiment.objective": ("storage", "taichi_nmm"),
    "study.commands": PACKAGES,  # the top, which nobody but the door imports
    # For anybody: it knows no walker.
    "study.sampler": (
        "study.sampler",
        "storage.foreign_tables",
        "storage.store",
        "storage.inputs",
    ),
}


def name_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules() -> dict[str, Path]:
    """Files of the packages and of tools/ by the names of their modules; not the hub's package."""
    files = [file for package in OURS for file in (ROOT / package).rglob("*.py")]
    return {name_of(file): file for file in sorted(files) if HUB not in file.parents}


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All that is run, now or in a call."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test).endswith(
            "TYPE_CHECKING"
        ):
            for other in child.orelse:
                yield other
                yield from statements(other)
        else:
            yield child
            yield from statements(child)


def named_by(node: ast.AST, package: str) -> list[str]:
    """What an import statement in a package names, in full."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    above = (
        package.split(".")[: len(package.split(".")) - node.level + 1]
        if node.level
        else []
    )
    base = ".".join([*above, *([node.module] if node.module else [])])
    return [f"{base}.{alias.name}" for alias in node.names]


def module_in(name: str) -> str | None:
    """The module that a full name is, or is a name of; None for other projects'."""
    while name and name not in modules():
        name = name.rpartition(".")[0]
    return name or None


@cache
def imported_by(module: str) -> frozenset[str]:
    """Modules of this project that a module imports."""
    file = modules()[module]
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = [name for node in statements(tree) for name in named_by(node, package)]
    found = {module_in(name) for name in names}
    return frozenset(name for name in found if name is not None and name != module)


def imports() -> list[tuple[str, str]]:
    return [(name, other) for name in modules() for other in sorted(imported_by(name))]


def within(name: str, part: str) -> bool:
    return name == part or name.startswith(f"{part}.")


def test_the_source_is_found() -> None:
    assert "study.sampler.space" in imported_by("study.sampler.columns")
    assert "storage.store" in imported_by("study.sampler.columns")  # in a function
    assert "study.experiment.features" not in imported_by("study")  # for types only


def test_no_imports_run_in_a_circle() -> None:
    try:
        TopologicalSorter({name: imported_by(name) for name in modules()}).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(reversed(error.args[1])))  # each imports the next


@pytest.mark.parametrize("part", ALLOWED)
def test_arrows_run_one_way(part: str) -> None:
    wrong = [
        f"{name} imports {other}"
        for name, other in imports()
        if within(name, part)
        if name != DOOR and not any(within(other, allowed) for allowed in ALLOWED[part])
    ]
    assert not wrong, "; ".join(wrong)


def test_commands_are_imported_by_nobody() -> None:
    wrong = [
        f"{name} imports {other}"
        for name, other in imports()
        if not within(name, "tools")
        if any(within(other, part) and not within(name, part) for part in COMMANDS)
    ]
    assert wrong == []  # study.cli imports them by their names


def lines_of(file: Path) -> int:
    return len(file.read_text(encoding="utf-8").splitlines())


def nodes_of(file: Path) -> int:
    """Nodes of a file's syntax tree, without docstrings."""
    count = 0
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        count += 1
        has_docstring = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if has_docstring and ast.get_docstring(node, clean=False) is not None:
            count -= 2  # the statement, and its string
    return count


def test_docstrings_and_comments_are_free(tmp_path: Path) -> None:
    bare, told = tmp_path / "bare.py", tmp_path / "told.py"
    bare.write_text("def f(a):\n    return a\n")
    told.write_text(
        '"""A file."""\n\n\ndef f(a):\n    """A function."""\n    return a  # why\n'
    )
    assert nodes_of(bare) == nodes_of(told) > 0


def test_the_house_keeps_its_budget() -> None:
    ours = [
        file
        for folder in (*OURS, "docs", "tests")
        for file in (ROOT / folder).rglob("*.py")
    ]
    ours = [
        file for file in ours if HUB / "build" not in file.parents
    ]  # what pip has left there
    tests = [
        file for file in ours if "tests" in file.relative_to(ROOT).parts
    ]  # the hub's too
    product = list(set(ours) - set(tests))
    assert 100_000 < sum(map(nodes_of, product)) <= MOST_NODES_OF_PRODUCT
    assert 100_000 < sum(map(nodes_of, tests)) <= MOST_NODES_OF_TESTS


def fields_of(source: str) -> dict[str, bool]:
    """Public fields of public dataclasses and named tuples: whether each is documented.

    It is where its name stands under `Attributes:` of the class, or a string below the
    field.
    """
    found = {}
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
            continue
        kinds = map(ast.unparse, (*node.decorator_list, *node.bases))
        if not any(re.match("dataclass|NamedTuple", kind) for kind in kinds):
            continue
        section = (ast.get_docstring(node) or "").partition("\nAttributes:\n")[2]
        own = re.split(r"^\S", section, flags=re.MULTILINE)[0]  # up to the next section
        told = re.findall(r"^ {4}(\w+): \S", own, flags=re.MULTILINE)
        for statement, below in pairwise([*node.body, ast.Pass()]):
            field = re.match(r"([a-zA-Z]\w*): (?!ClassVar)", ast.unparse(statement))
            if field is not None:
                is_told = field[1] in told or isinstance(below, ast.Expr)
                found[f"{node.name}.{field[1]}"] = is_told
    return found


HELD = '''
@dataclass(frozen=True)
class Walk:
    """A walk; speed: not said here.

    Attributes:
        time_s: [t].
        load_n: of each foot,
            as sensed: by the ground, [t, 2].

    Raises:
        height_m: is no attribute.
    """

    KIND: ClassVar[str] = "walk"
    time_s: float
    load_n: float
    speed: float
    height_m: float
    sensed: float
    lean_rad: float
    """Of the trunk, [t]."""


class Range(NamedTuple):
    low: float  # a comment, which nobody is shown


class Other:
    name: str
'''


def test_a_field_without_words_is_found() -> None:
    assert fields_of(HELD) == {
        "Walk.time_s": True,
        "Walk.load_n": True,
        "Walk.speed": False,
        "Walk.height_m": False,
        "Walk.sensed": False,
        "Walk.lean_rad": True,
        "Range.low": False,
    }


def test_what_users_hold_is_documented() -> None:
    fields = {
        f"{module}: {name}": is_told
        for module, file in modules().items()
        for name, is_told in fields_of(file.read_text(encoding="utf-8")).items()
    }
    silent = [name for name, is_told in fields.items() if not is_told]
    assert len(fields) > 500
    assert len(silent) <= (1.0 - LEAST_DOCUMENTED) * len(fields), ", ".join(silent)


def test_no_file_is_long() -> None:
    lines = {name: lines_of(file) for name, file in modules().items()}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}
