"""The explorer as a process, on folders that a formula filled."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.tools.running import ROOT


@contextmanager
def explorer(folder: Path, *options: str) -> Iterator[str]:
    """The address of its page."""
    command = [sys.executable, ROOT / "tools" / "explore.py", folder, "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[1]
        process.terminate()
