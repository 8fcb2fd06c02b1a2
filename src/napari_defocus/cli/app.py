"""The terminal program: its commands, and how it starts."""

from __future__ import annotations

import logging
import sys
import warnings
from typing import Annotated, Any

import typer
import typer.core

import napari_defocus
from napari_defocus.cli.batch import batch
from napari_defocus.cli.console import end_as_after_ctrl_c
from napari_defocus.cli.depth import depth
from napari_defocus.cli.explain import explain
from napari_defocus.cli.lens import calibrate, compare
from napari_defocus.cli.map import map_picture
from napari_defocus.cli.report import report
from napari_defocus.cli.restore import refocus, restore
from napari_defocus.cli.sample import demonstrate, sample
from napari_defocus.cli.segment import segment_picture
from napari_defocus.cli.stack import sharpest

app: typer.Typer = typer.Typer(
    name="napari-defocus",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the terminal command; the entry point of ``napari-defocus``."""
    _keep_libraries_quiet()
    end_as_after_ctrl_c()
    app()


def _keep_libraries_quiet() -> None:
    """Leave standard error to this program's own lines."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    for library in ("tifffile", "matplotlib", "PIL"):
        logging.getLogger(library).addHandler(logging.NullHandler())


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"napari-defocus {napari_defocus.__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Measure the defocus blur of one picture: how many pixels wide, and what is in focus."""


_OF_MANY = {"map": "batch", "segment": "batch --mask", "restore": "batch --restore"}
"""What does for many pictures what a command does for one."""


class _OnePicture(typer.core.TyperCommand):
    """A command that takes one picture, and says which command takes many."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except Exception as error:  # a UsageError; whose, depends on typer's version
            message: str | None = getattr(error, "message", None)
            if message and "unexpected extra argument" in message:
                vars(error)["message"] = (
                    f"{message}. {self.name} takes one picture; for many there is "
                    f"napari-defocus {_OF_MANY[str(self.name)]} PICTURES -o FOLDER"
                )
            raise


for _name, _command in {
    "map": map_picture,
    "segment": segment_picture,
    "demo": demonstrate,
    "sample": sample,
    "restore": restore,
    "refocus": refocus,
    "batch": batch,
    "report": report,
    "depth": depth,
    "explain": explain,
    "sharpest": sharpest,
    "calibrate": calibrate,
    "compare-psf": compare,
}.items():
    app.command(_name, cls=_OnePicture if _name in _OF_MANY else None)(_command)
