"""The explorer as a process."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from tests.tools.running import ROOT

MODEL = "Bokeh.documents[0].get_model_by_name"


@contextmanager
def explorer(
    folder: Path, errors: IO[str] | None = None, words: Sequence[str] = ()
) -> Iterator[str]:
    """The address of its page; `errors` takes what it prints of errors, `words` are options."""
    options = ("--port", "0", "--no-browser", *words)
    command = [sys.executable, "-m", "taichi_nmm", "explore", folder, *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=errors, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split()[1]
        finally:
            process.terminate()
