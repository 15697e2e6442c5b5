"""A process that holds a share of the studies; the main process asks, simulates, and tells it.

Messages are pairs: what, and with what. Each is answered by ("done", result), ("input", an
`InputError`) or ("failed", a traceback).
"""

import traceback
from multiprocessing.connection import Connection
from typing import Any

import pyarrow as pa

from study.comparison.experiment import Experiment
from study.comparison.group import Key, StudyGroup
from taichi_nmm.errors import InputError


def work(
    messages: Connection,
    experiment: Experiment,
    studies: dict[int, Key],
    trials: int,
    known: dict[str, pa.Table],
) -> None:
    """Serve until the main process closes its end, or is gone."""
    group: StudyGroup | None = None
    while True:
        try:
            what, arguments = messages.recv()
        except (EOFError, ConnectionResetError):
            return
        try:
            if what == "start":
                group = StudyGroup(experiment, studies, trials)
                group.restore(known)
                answer: tuple[str, Any] = "done", None
            else:
                answer = "done", getattr(group, what)(*arguments)
        except InputError as error:
            answer = "input", error
        except Exception:
            answer = "failed", traceback.format_exc()
        try:
            messages.send(answer)
        except (BrokenPipeError, ConnectionResetError):
            return
