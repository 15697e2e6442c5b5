"""Python in a process of its own."""

import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def python(*words: object, **options: Any) -> "subprocess.CompletedProcess[str]":
    """Run it on these words, in the root unless `cwd` is given, and keep what it prints."""
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, **{"cwd": ROOT, "capture_output": True, "text": True} | options)
