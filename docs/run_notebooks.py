"""A hook of mkdocs: each notebook runs when the site is built, and becomes a page with its outputs.

A notebook becomes Markdown, so that its links are checked and its code looks like any
other page's. An error in a cell is an error of the build; its output on standard error
is a warning.
"""

import base64
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

LONGEST_CELL_S = 300
# Two warnings are about this machine, not the notebook: tqdm finds no widgets, and the
# kernel talks to this process in plain text.
ENVIRONMENT = {"PYTHONWARNINGS": "ignore:IProgress not found"}
ERRORS_ONLY = ["--log-level=40"]

log = get_plugin_logger("notebooks")


class Page(File):
    """A page whose name does not end as those of Markdown."""

    def is_documentation_page(self) -> bool:
        """Whether it is a page: yes."""
        return True


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Put the page and the pictures of each notebook in its place."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        pictures: dict[str, bytes] = {}
        parts = markdown(
            executed(Path(config.docs_dir, file.src_uri)), file.name, pictures
        )
        page = Page.generated(config, file.src_uri, content="\n\n".join(parts))
        files.remove(file)
        files.append(page)
        folder = Path(file.src_uri).parent
        for name, content in pictures.items():
            files.append(File.generated(config, str(folder / name), content=content))
    return files


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook with its outputs; it runs in an empty folder."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=LONGEST_CELL_S,
            resources={"metadata": {"path": folder}},
            extra_arguments=ERRORS_ONLY,
            coalesce_streams=True,
        )
        try:
            # Cells' errors come in messages; a kernel's own last words may be an abort
            # of libzmq.
            return client.execute(
                env=os.environ | ENVIRONMENT, stderr=subprocess.DEVNULL
            )
        except CellExecutionError as error:
            raise PluginError(f"{path.name}: {error}") from None


def markdown(
    notebook: nbformat.NotebookNode, name: str, pictures: dict[str, bytes]
) -> Iterator[str]:
    """The notebook's text, code and outputs; pictures are added by the names of their files."""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            yield cell.source
            continue
        yield fenced(cell.source, "python")
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{name}-{len(pictures) + 1}.png"
                pictures[picture] = base64.b64decode(data["image/png"])
                # As display(..., metadata={"image/png": {"alt": ...}}) describes it.
                said = output.metadata.get("image/png", {}).get(
                    "alt", "what the code drew"
                )
                yield f"![{said}]({picture})"
            elif output.get("name") == "stderr":
                log.warning(f"{name}: {output.text.strip()}")
            else:
                yield fenced(output.get("text") or data["text/plain"], "text")


def fenced(text: str, language: str) -> str:
    """A block of code, or of what code printed."""
    return f"```{language}\n{text.rstrip()}\n```"
