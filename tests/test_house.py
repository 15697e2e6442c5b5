"""The house of CONTRIBUTING.md: who may know whom, no circles, and what the house measures.

Read from the source alone, so that nothing is imported. A function's imports count;
those under `if TYPE_CHECKING` do not.
"""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("taichi_nmm", "storage", "study")
OURS = (*PACKAGES, "tools")
HUB = ROOT / "study" / "hub"  # a package of another registry, which nobody imports
DOOR = "taichi_nmm.__main__"  # of the commands: the one module that looks up
COMMANDS = ("tools", "study.commands")

# No measure may be larger. A node is one of the syntax tree: neither width nor
# docstrings nor comments change their number.
BOUNDS = {
    "nodes of the product": 322_794,
    "nodes of the tests": 309_269,
    "characters a line of the product": 46.5,
    "characters a line of the tests": 48.0,
    "lines of 90 and more columns, %": 7.0,
    "lines with `fmt: skip`": 60,
    "constructions of six and more by place": 10,
    "public fields without words, %": 5.0,
    "lines of the longest function": 90,
    "lines of the longest file": 600,
    "words of the documents": 52_198,
}

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


def name_of(file):
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules():
    """Files of the packages and of tools/ by the names of their modules; not the hub's package."""
    files = [file for package in OURS for file in (ROOT / package).rglob("*.py")]
    return {name_of(file): file for file in sorted(files) if HUB not in file.parents}


def statements(node):
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


def named_by(node, package):
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


def module_in(name):
    """The module that a full name is, or is a name of; None for other projects'."""
    while name and name not in modules():
        name = name.rpartition(".")[0]
    return name or None


@cache
def imported_by(module):
    """Modules of this project that a module imports."""
    file = modules()[module]
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = [name for node in statements(tree) for name in named_by(node, package)]
    found = {module_in(name) for name in names}
    return frozenset(name for name in found if name is not None and name != module)


def imports():
    return [(name, other) for name in modules() for other in sorted(imported_by(name))]


def within(name, part):
    return name == part or name.startswith(f"{part}.")


def test_the_source_is_found():
    assert "study.sampler.space" in imported_by("study.sampler.columns")
    assert "storage.store" in imported_by("study.sampler.columns")  # in a function
    assert "study.experiment.features" not in imported_by("study")  # for types only


def test_no_imports_run_in_a_circle():
    try:
        TopologicalSorter({name: imported_by(name) for name in modules()}).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(reversed(error.args[1])))  # each imports the next


@pytest.mark.parametrize("part", ALLOWED)
def test_arrows_run_one_way(part):
    wrong = [
        f"{name} imports {other}"
        for name, other in imports()
        if within(name, part)
        if name != DOOR and not any(within(other, allowed) for allowed in ALLOWED[part])
    ]
    assert not wrong, "; ".join(wrong)


def test_commands_are_imported_by_nobody():
    wrong = [
        f"{name} imports {other}"
        for name, other in imports()
        if not within(name, "tools")
        if any(within(other, part) and not within(name, part) for part in COMMANDS)
    ]
    assert wrong == []  # study.cli imports them by their names


class Source:
    """A Python file of ours, parsed once."""

    def __init__(self, text):
        self.text = text
        self.lines = text.splitlines()
        self.nodes = list(ast.walk(ast.parse(text)))

    def size(self):
        """Nodes without those of docstrings: the statement, and its string."""
        owners = ast.Module | ast.ClassDef | ast.FunctionDef
        told = [
            node
            for node in self.nodes
            if isinstance(node, owners)
            and ast.get_docstring(node, clean=False) is not None
        ]
        return len(self.nodes) - 2 * len(told)

    def longest_function(self):
        lines = [
            (node.end_lineno or 0) - node.lineno + 1
            for node in self.nodes
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        ]
        return max(lines, default=0)

    def long_constructions(self):
        """Calls of a class with six and more things that only their places name."""
        return sum(
            isinstance(node, ast.Call)
            and len(node.args) >= 6
            and re.search(r"(^|\.)[A-Z]\w*$", ast.unparse(node.func)) is not None
            for node in self.nodes
        )

    def fields(self):
        """Public fields of public dataclasses and named tuples: whether each is documented.

        It is where its name stands under `Attributes:` of the class, or a string below
        the field.
        """
        found = {}
        for node in self.nodes:
            if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
                continue
            kinds = map(ast.unparse, (*node.decorator_list, *node.bases))
            if not any(re.match("dataclass|NamedTuple", kind) for kind in kinds):
                continue
            told = attributes_of(ast.get_docstring(node) or "")
            for statement, below in pairwise([*node.body, ast.Pass()]):
                field = re.match(r"([a-zA-Z]\w*): (?!ClassVar)", ast.unparse(statement))
                if field is not None:
                    is_told = field[1] in told or isinstance(below, ast.Expr)
                    found[f"{node.name}.{field[1]}"] = is_told
        return found


def attributes_of(docstring):
    """The names under `Attributes:`, up to the next section."""
    section = docstring.partition("\nAttributes:\n")[2]
    own = re.split(r"^\S", section, flags=re.MULTILINE)[0]
    return re.findall(r"^ {4}(\w+): \S", own, flags=re.MULTILINE)


def sources(folders):
    """All files of some folders; but what pip has left in the hub's."""
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.py")]
    return {
        file.relative_to(ROOT).as_posix(): Source(file.read_text(encoding="utf-8"))
        for file in files
        if HUB / "build" not in file.parents
    }


def widths(files):
    """Of the lines that are not blank."""
    return [len(line) for file in files for line in file.lines if line.strip()]


def fields():
    """All public fields of the product: whether each is documented."""
    return {
        f"{name}: {field}": is_told
        for name, file in sources(OURS).items()
        for field, is_told in file.fields().items()
    }


def percent(truths):
    return 100.0 * fmean(truths)


@cache
def measures():
    """What `BOUNDS` bounds. The hub's package is product; its tests are tests."""
    product, tests = sources((*OURS, "docs")).values(), sources(["tests"]).values()
    every = [*product, *tests]
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    return {
        "nodes of the product": sum(file.size() for file in product),
        "nodes of the tests": sum(file.size() for file in tests),
        "characters a line of the product": fmean(widths(product)),
        "characters a line of the tests": fmean(widths(tests)),
        "lines of 90 and more columns, %": percent(
            [width >= 90 for width in widths(every)]
        ),
        "lines with `fmt: skip`": sum(file.text.count("# fmt: skip") for file in every),
        "constructions of six and more by place": sum(
            file.long_constructions() for file in product
        ),
        "public fields without words, %": percent(
            [not is_told for is_told in fields().values()]
        ),
        "lines of the longest function": max(file.longest_function() for file in every),
        "lines of the longest file": max(len(file.lines) for file in every),
        "words of the documents": sum(
            len(page.read_text(encoding="utf-8").split()) for page in pages
        ),
    }


@pytest.mark.parametrize(("measure", "bound"), BOUNDS.items())
def test_the_house_keeps_its_bounds(measure, bound):
    assert measures()[measure] <= bound


def test_all_of_the_house_is_measured():
    assert measures().keys() == BOUNDS.keys()
    assert measures()["nodes of the product"] > 100_000
    assert measures()["nodes of the tests"] > 100_000
    assert len(fields()) > 500


def test_docstrings_and_comments_are_free():
    bare = Source("def f(a):\n    return a\n")
    told = Source(
        '"""A file."""\n\n\ndef f(a):\n    """A function."""\n    return a  # why\n'
    )
    assert bare.size() == told.size() > 0
    assert (bare.longest_function(), told.longest_function()) == (2, 3)


def test_only_a_class_is_constructed():
    code = "{}(1, 2, 3, 4, 5, 6)\n"
    for call, count in (("Model", 1), ("policy.Model", 1), ("model", 0), ("M.of", 0)):
        assert Source(code.format(call)).long_constructions() == count
    assert Source("Model(1, 2, 3, 4, 5, six=6)").long_constructions() == 0


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


def test_a_field_without_words_is_found():
    assert Source(HELD).fields() == {
        "Walk.time_s": True,
        "Walk.load_n": True,
        "Walk.speed": False,
        "Walk.height_m": False,
        "Walk.sensed": False,
        "Walk.lean_rad": True,
        "Range.low": False,
    }
