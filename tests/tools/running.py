"""A command, run in this process, where tests can replace what it calls; or in one of its own.

Or with an accident: a package is missing, or Ctrl-C comes in the middle of an import.
"""

import importlib.util
import os
import runpy
import subprocess
import sys
from importlib import import_module
from typing import NamedTuple

from study.cli import main
from study.options import COMMANDS
from tests.processes import ROOT, python

PARTS = {
    "time_walks_worker",
    "checkout",
    "measured",
    "measured_arms",
    "peers",
    "outside",
    "page",
    "runs",
}  # of other tools
TOOLS = sorted({path.stem for path in (ROOT / "tools").glob("*.py")} - PARTS)
sys.path.append(str(ROOT / "tools"))  # where a tool that is run finds checkout.py
INTERRUPTED = "interrupted: finished work is kept; the same command resumes"
WAIT_S = 300.0  # of a process, which may compile the simulator first


def run_tool(patch, tool, *arguments):
    """Exit code of a command, imported anew so that it finds what is replaced, or of a tool."""
    forget_commands()
    words = [*map(str, arguments)]
    command = tool.replace("_", "-")
    try:
        if command in COMMANDS:
            main([command, *words])
        else:
            patch.setattr(sys, "argv", [f"{tool}.py", *words])
            patch.setattr(sys, "path", list(sys.path))
            runpy.run_path(str(ROOT / "tools" / f"{tool}.py"), run_name="__main__")
    except SystemExit as end:
        return int(end.code or 0)
    return 0


FAKE = (ROOT / "tests" / "tools" / "fake_command.py",)


def start(*words, program=FAKE, shell="", **accidents):
    """A command in a process of its own, by default with the fake simulator.

    `shell` has redirections or a limit, in Bash; accidents are those of
    fake_command.py, in small letters, such as trial_s=0.1.
    """
    line = [sys.executable, *map(str, (*program, *words))]
    return subprocess.Popen(
        ["bash", "-c", shell, "bash", *line] if shell else line,
        env=os.environ
        | {f"FAKE_{key.upper()}": str(value) for key, value in accidents.items()},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # a terminal's Ctrl-C reaches all of it
    )


class Done(NamedTuple):
    """How a process ended."""

    code: int
    out: str
    error: str

    @property
    def lines(self):
        """Of standard error."""
        return self.error.replace("\r", "\n").splitlines()

    @property
    def last(self):
        """The last of them."""
        return next(reversed(self.lines), "")


def finish(process):
    """Wait until it has ended."""
    out, error = process.communicate(timeout=WAIT_S)
    return Done(process.returncode, out, error)


def forget_commands():
    """Have the next import of a command run its file."""
    for name in [name for name in sys.modules if name.startswith("study.commands.")]:
        del sys.modules[name]


def load_command(command):
    """study/commands/COMMAND.py, imported anew."""
    forget_commands()
    return import_module(f"study.commands.{command}")


def load_tool(tool):
    """tools/TOOL.py as a module, not run."""
    file = ROOT / "tools" / f"{tool}.py"
    specification = importlib.util.spec_from_file_location(f"tools_{tool}", file)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


# Runs before anything else in a process that has its folder on PYTHONPATH.
SITE = """
import os, signal, sys

class Accident:
    def find_spec(self, name, path=None, target=None):
        if name in os.environ.get("MISSING", "").split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if name == os.environ.get("INTERRUPTED"):
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Accident())
for name in os.environ.get("MISSING", "").split(","):
    sys.modules.pop(name, None)  # Python itself may have imported it
"""


def run_with_accident(folder, words, missing=(), interrupted=""):
    """Python on these words in `folder`; `interrupted` is the import at which Ctrl-C comes."""
    (folder / "site").mkdir(exist_ok=True)
    (folder / "site" / "sitecustomize.py").write_text(SITE)
    accident = {"MISSING": ",".join(missing), "INTERRUPTED": interrupted}
    path = os.pathsep.join((str(folder / "site"), str(ROOT)))
    return python(
        *words, cwd=folder, env={**os.environ, **accident, "PYTHONPATH": path}
    )
