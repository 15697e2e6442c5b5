"""The cluster that a user asks for, checked before anything is imported or written."""

import re
from dataclasses import dataclass
from importlib.util import find_spec

from taichi_nmm.errors import InputError, shortened

MOST_LOCAL = 256  # processes of this machine
FORMS = f"local:N with N from 1 to {MOST_LOCAL}, or a scheduler's HOST:PORT, tcp:// or tls://"
_LOCAL = re.compile(r"local:([1-9]\d{0,2})")
_SCHEDULER = re.compile(r"(?!local:)((tcp|tls)://)?(\[[0-9a-fA-F:.%]+\]|[\w.-]+):\d{1,5}", re.ASCII)


@dataclass(frozen=True)
class Cluster:
    """What a user asks for.

    Attributes:
        address: of a scheduler; or "local:N", N processes of this machine.
        mixed: whether workers may differ from one another in what they compute.
    """

    address: str
    mixed: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no address.

        Raises:
            InputError: neither form, or the package distributed is not there.
        """
        local = _LOCAL.fullmatch(self.address)
        if local is not None and int(local[1]) > MOST_LOCAL:
            raise InputError("cluster", self.address, FORMS)
        if local is None and not _SCHEDULER.fullmatch(self.address):
            # An "@" is where somebody's password would end.
            said = shortened(self.address) if "@" not in self.address else "..."
            raise InputError("cluster", said, FORMS)
        if find_spec("distributed") is None:
            allowed = "an environment with distributed: pip install 'taichi-nmm[cluster]'"
            raise InputError("cluster", self.address, allowed)

    @property
    def local_processes(self) -> int:
        """Processes of this machine to start; 0: the cluster is there already."""
        local = _LOCAL.fullmatch(self.address)
        return int(local[1]) if local else 0
