"""Wide registers: nothing changes where something is not as expected."""

import ctypes
import os
from pathlib import Path

import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.kernel import compiler, registers

LIBRARY, VERSION = compiler.core.__file__, registers.TAICHI_VERSION


@pytest.mark.skipif(not registers._address_of_setting(LIBRARY), reason="another system")
def test_only_this_library_of_this_version_is_told(tmp_path: Path) -> None:
    setting = ctypes.c_uint32.from_address(registers._address_of_setting(LIBRARY) or 0)
    before, cut = setting.value, tmp_path / "cut"
    cut.write_bytes(Path(LIBRARY).read_bytes()[:4096])
    for other in ("/proc/self/exe", os.devnull, __file__, str(cut), "none"):
        assert not registers.tell_vectoriser(5, other, VERSION)
    assert not registers.tell_vectoriser(5, LIBRARY, (1, 7, 5)) and setting.value == before
    assert registers.tell_vectoriser(before, LIBRARY, VERSION) and setting.value == before


def test_the_width_is_known_unknown_or_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    for features, width in (("fpu avx2 avx512vl", 16), ("fpu avx2", 8), ("fpu avx512vlx", 0)):
        monkeypatch.setattr(Path, "read_text", lambda _path, text=features: text)
        assert registers.width() == width
    monkeypatch.setenv(registers.VARIABLE, "0")
    assert registers.width() == 0
    monkeypatch.setenv(registers.VARIABLE, "yes")
    with pytest.raises(InputError, match=registers.VARIABLE):
        registers.width()


def test_only_remarks_are_kept_off_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    with registers.without_remarks():
        os.write(2, registers.REMARK + b": a call\nan error\n")
    assert capfd.readouterr().err == "an error\n"
