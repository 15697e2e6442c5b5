"""Wide registers: LLVM is told how many walkers a register of this processor holds.

Taichi 1.7.4 vectorises with LLVM 15, which it gives the processor's name and none of
its features. For a name that LLVM 15 does not know, the vectoriser takes registers of 4
numbers, and else of 8 at most; the generator of machine code, which follows, knows the
true width. So the vectoriser is told, by a setting of LLVM's own: an int in Taichi's
library, which the library's symbols name. Results keep their bits. Wherever something
is not as expected (another version, system or processor), everything stays as Taichi
has it.
"""

import ctypes
import mmap
import os
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from storage.inputs.errors import InputError

VARIABLE = "TAICHI_NMM_WIDE_REGISTERS"  # 0 switches this off, as `Settings.wide_registers` does
TAICHI_VERSION = (1, 7, 4)
# How many float32 numbers a register holds, by a processor's feature.
WIDTHS = {
    "avx512vl": 16,
    "avx2": 8,
}

# LLVM's setting; at 0 the vectoriser chooses.
SETTING = "_ZN4llvm16VectorizerParams19VectorizationFactorE"
# A function of the library, whose address Python can tell: the setting lies as far
# from it as in the file.
NEIGHBOUR = "PyInit_taichi_python"
# The header says where sections are described, in how many bytes, and how many.
ELF_HEADER = "<40xQ10xHH"
SECTION = "<4xI16xQQI"  # kind, start, length, section of names
SYMBOL_TABLE = 2  # a kind of section
SYMBOL = struct.Struct("<I4xQQ")  # where its name is, address, length
REMARK = b"remark: <unknown>:0:0: loop not vectorized"


def width() -> int:
    """Numbers of a register; 0 where that is unknown, or switched off.

    Raises:
        InputError: the environment's switch is neither 0 nor 1.
    """
    switch = os.environ.get(VARIABLE, "1")
    if switch not in ("0", "1"):
        raise InputError(VARIABLE, switch, "0 or 1")
    try:
        features = Path("/proc/cpuinfo").read_text().split() if switch == "1" else []
    except OSError:  # another system
        return 0
    return next((width for feature, width in WIDTHS.items() if feature in features), 0)


def tell_vectoriser(numbers: int, library: str, version: tuple[int, ...]) -> bool:
    """Have loops vectorised by so many numbers from now on, by LLVM's choice for 0.

    Args:
        numbers: of a register.
        library: Taichi's, which is loaded.
        version: Taichi's.

    Returns:
        Whether the vectoriser was told.
    """
    address = _address_of_setting(library) if version == TAICHI_VERSION else None
    if address is None:
        return False
    ctypes.c_uint32.from_address(address).value = numbers
    return True


@cache
def _address_of_setting(library: str) -> int | None:
    try:
        (setting, length), (neighbour, _) = _symbols(library, SETTING, NEIGHBOUR)
        loaded = ctypes.cast(
            getattr(ctypes.PyDLL(library), NEIGHBOUR), ctypes.c_void_p
        ).value
    except (OSError, ValueError, IndexError, StopIteration, struct.error):
        return None
    if loaded is None or length != ctypes.sizeof(ctypes.c_uint32):
        return None
    return loaded + setting - neighbour


def _symbols(library: str, *wanted: str) -> list[tuple[int, int]]:
    """Address and length of symbols of a library in ELF.

    Raises:
        OSError, ValueError, IndexError, StopIteration, struct.error: it has no such
            symbols.
    """
    with (
        Path(library).open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as elf,
    ):
        first, size, count = struct.unpack_from(ELF_HEADER, elf)
        sections = [
            struct.unpack_from(SECTION, elf, first + size * i) for i in range(count)
        ]
        _, start, length, names = next(s for s in sections if s[0] == SYMBOL_TABLE)
        _, names_start, names_length, _ = sections[names]
        found = []
        for name in wanted:
            place = _find(elf, f"\0{name}\0".encode(), names_start, names_length) + 1
            entry = _find(elf, struct.pack("<I", place), start, length, SYMBOL.size)
            found.append(SYMBOL.unpack_from(elf, start + entry)[1:])
        return found


def _find(elf: mmap.mmap, wanted: bytes, start: int, length: int, step: int = 1) -> int:
    """Where in a section `wanted` is, at a multiple of `step`."""
    at = elf.find(wanted, start, start + length)
    while at >= 0 and (at - start) % step:
        at = elf.find(wanted, at + 1, start + length)
    if at < 0:
        raise ValueError
    return at - start


@contextmanager
def without_remarks() -> Iterator[None]:
    """Keep LLVM's remarks on loops of Taichi's own off standard error, and pass on all else."""
    try:
        heard = tempfile.TemporaryFile()  # noqa: SIM115  (closed below)
        kept = os.dup(2)
    except OSError:  # standard error is closed, or there is no place for files
        yield
        return
    with heard:
        os.dup2(heard.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            heard.seek(0)
            for line in heard:
                if not line.startswith(REMARK):
                    os.write(2, line)
