"""What the page says of a call that failed."""

import pytest

from study.explore.server import OURS, Message

LACKED = "libX11.so.6: cannot open shared object file: No such file or directory"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            ModuleNotFoundError("No module named 'mujoco'", name="mujoco"),
            "package: 'mujoco' is not installed; allowed: an environment that has it",
        ),
        (
            ImportError(LACKED, name="taichi_python", path="/lib/taichi_python.abi3.so"),
            f"taichi_python: '{LACKED}' cannot be used; "
            "allowed: a machine with the libraries that taichi_python needs (README.md)",
        ),
    ],
)
def test_what_the_machine_lacks_is_said(error: ImportError, said: str) -> None:
    message = Message()
    message.failed(error)
    assert message.layout.text == said.replace("'", "&#x27;")


def test_a_mistake_of_ours_is_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    message = Message()
    message.failed(ImportError("cannot import name 'x'", name="study.view", path="/study/view.py"))
    assert message.layout.text == OURS
    assert "cannot import name 'x'" in capsys.readouterr().err
