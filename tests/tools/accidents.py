"""Processes in which an import goes wrong: a package is missing, or Ctrl-C comes in the middle."""

import os
import subprocess
from collections.abc import Iterable
from pathlib import Path

from tests.processes import ROOT, python

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


def run_with_accident(
    folder: Path, words: Iterable[object], missing: Iterable[str] = (), interrupted: str = ""
) -> "subprocess.CompletedProcess[str]":
    """Python on these words in `folder`; `interrupted` is the import at which Ctrl-C comes."""
    (folder / "site").mkdir(exist_ok=True)
    (folder / "site" / "sitecustomize.py").write_text(SITE)
    accident = {"MISSING": ",".join(missing), "INTERRUPTED": interrupted}
    path = os.pathsep.join((str(folder / "site"), str(ROOT)))
    return python(*words, cwd=folder, env={**os.environ, **accident, "PYTHONPATH": path})
