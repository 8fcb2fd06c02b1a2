"""The terminal command that writes a bundled photograph, to try the others on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.resources import files as resources
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from napari_defocus.cli.command import check_endings, run
from napari_defocus.cli.option_groups import Reporting
from napari_defocus.cli.options import Force
from napari_defocus.core.progress import Progress

SampleName = Literal["dandelion", "brushes"]

AUTHORS: dict[SampleName, str] = {
    "dandelion": "seeding, by Clements Engelhardt, CC0-1.0",
    "brushes": "Picture 1A, by freespace, CC-BY-4.0",
}


def sample_path(name: SampleName) -> Path:
    """Return where a photograph lies in the package."""
    return Path(str(resources("napari_defocus") / "samples" / f"{name}.jpg"))


def sample(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="What to write: a JPEG file.")
    ] = Path("photo.jpg"),
    *,
    name: Annotated[SampleName, typer.Option(help="Which photograph.")] = "dandelion",
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Write a photograph of ours, to try the other commands on."""

    def write(_: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing

        check_endings([file], ".jpg", ".jpeg")
        writing.write_results({file: sample_path(name).read_bytes()}, force=force)
        return {"sample": name, "author": AUTHORS[name], "files": [str(file)]}

    run(write, _lines, reporting)


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield f"picture      {facts['sample']}: {facts['author']}"
    for path in facts["files"]:
        yield f"wrote        {path}"
