"""Run tools/precompute.py with the fake simulator, and with accidents.

    python -m tests.tools.launch_precompute '{"delay_s": 0.05}' --config FILE --out DIR

delay_s: seconds a simulation takes. interrupt_in_call: Ctrl-C comes in the n-th simulation.
kill_at_rename: die, as by kill -9, before the n-th file gets its name. largest_file_bytes: the
system refuses to write more, as a full disk does.
"""

import json
import os
import resource
import signal
import sys
import time
from itertools import count
from pathlib import Path
from typing import Any

import taichi_nmm
from study.cli import main as run
from taichi_nmm.result import Result
from tests.storage import fake


def install_simulator(delay_s: float, interrupt_in_call: int) -> None:
    numbers = count(1)

    def simulate(*args: Any, **options: Any) -> Result:
        time.sleep(delay_s)
        if next(numbers) == interrupt_in_call:
            signal.raise_signal(signal.SIGINT)
        return fake.simulate(*args, **options)

    vars(taichi_nmm)["simulate"] = simulate


def die_at_rename(number: int) -> None:
    rename, renamed = Path.replace, []

    def replace(self: Path, target: Path) -> Path:
        renamed.append(target)
        if len(renamed) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return rename(self, target)

    Path.replace = replace  # type: ignore[method-assign, assignment]


def main() -> None:
    accidents = json.loads(sys.argv[1])
    install_simulator(accidents.get("delay_s", 0.0), accidents.get("interrupt_in_call", 0))
    if "kill_at_rename" in accidents:
        die_at_rename(accidents["kill_at_rename"])
    if "largest_file_bytes" in accidents:
        limit = accidents["largest_file_bytes"]
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    run(["precompute", "--workers", "1", *sys.argv[2:]])  # other processes would have no fake


if __name__ == "__main__":
    main()
