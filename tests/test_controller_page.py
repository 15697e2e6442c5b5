"""docs/controller.md keeps its word: the biped on that page walks, in a process of its own."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "controller.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


def test_the_body_of_the_page_walks_100_s(tmp_path: Path) -> None:
    (tmp_path / "body.py").write_text(blocks("python")[0])
    done = subprocess.run(
        [sys.executable, "body.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    walked, distance, speed = map(float, re.findall(r"[\d.]+", done.stdout))
    assert walked == 100.0
    assert 1.1 < speed < 1.5 and abs(distance - 100 * speed) < 2.0
    assert blocks("text")[0].split("at")[0].split(",")[0] == done.stdout.split(",")[0]
