"""What every command shares: one line and an exit code for whatever a user can get wrong."""

import sys
from collections.abc import Callable
from ctypes.util import find_library

from storage.pool import cores
from taichi_nmm.errors import InputError
from taichi_nmm.kernel_cache import require_kernel_cache
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.settings import Settings

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells have it
GPUS = ("cuda", "vulkan")


def run_command(main: Callable[[], None]) -> None:
    """Run a command's `main` and leave the process with its exit code.

    Bad input prints one line on standard error and exits with 2; Ctrl-C exits with 130 and says
    that what was finished is kept.
    """
    try:
        main()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        print("interrupted: finished work is kept; the same command resumes", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def require_engine(settings: Settings) -> None:
    """Refuse a machine on which the simulator cannot run, before any file is touched.

    Raises:
        InputError: no place for compiled kernels, a GPU that is not there, or MuJoCo is asked for
            and is not.
    """
    require_kernel_cache()
    if settings.engine == "mujoco":
        require_mujoco()
    if settings.arch in GPUS:
        _started_arch(settings)


def default_workers(settings: Settings) -> int:
    """Processes that a command takes where nobody says: a core each; one where a GPU computes.

    Raises:
        InputError: a GPU that is not there.
    """
    cpu = settings.arch == "cpu" or settings.engine == "mujoco"
    no_gpu = cpu or (settings.arch == "auto" and not find_library("cuda"))
    return cores() if no_gpu or _started_arch(settings) == "cpu" else 1


def _started_arch(settings: Settings) -> str:
    """Where the simulator computes with these settings; it is started, which takes a second."""
    from taichi_nmm.kernel import backend

    backend.start(settings)
    return str(backend.metadata()["arch"])
