"""The configurations that come with the project, by their names: in a checkout, or installed."""

import tomllib
from pathlib import Path

from taichi_nmm.reading import is_file

INSTALLED = Path(__file__).resolve().parent / "configs"  # where a wheel has them
CONFIGS = INSTALLED if INSTALLED.is_dir() else INSTALLED.parents[1] / "configs"


def config_path(name: str | Path) -> Path:
    """The configuration of this name that comes with the project; or else the file itself.

    A name is a word, such as rough8; whatever has a folder or a suffix is a file.
    """
    shipped = CONFIGS / f"{name}.toml"
    is_word = Path(name).name == str(name)
    return shipped if is_word and is_file(shipped) else Path(name)


def shipped_configs(stores: bool) -> dict[str, str]:
    """Names of those of stores, or of experiments, and what the first line of each says."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(CONFIGS.glob("*.toml"))}
    return {
        name: text.partition("\n")[0].lstrip("# ")
        for name, text in texts.items()
        if ("samples" in tomllib.loads(text)) == stores
    }
