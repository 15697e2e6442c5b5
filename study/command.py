"""What a command asks of the machine before it writes anything: an engine, and processes."""

from ctypes.util import find_library

from storage.pool import cores
from taichi_nmm.kernel_cache import require_kernel_cache
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.settings import Settings

GPUS = ("cuda", "vulkan")


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
