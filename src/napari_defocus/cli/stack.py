"""The terminal command for a stack through focus: which plane is sharp where, and one picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.cli.command import check_endings, last_lines, run
from napari_defocus.cli.option_groups import Reporting
from napari_defocus.cli.options import (
    ColorSigma,
    Force,
    IntensityRange,
    LinearizeOption,
    MapSmoothness,
    MaxRadius,
    NoiseVariance,
    PSFText,
)
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import beside, intensity_facts
from napari_defocus.settings import CONFIDENT, MapSettings

if TYPE_CHECKING:
    from napari_defocus.core.axes import FocusAxis
    from napari_defocus.io.open import Source
    from napari_defocus.stacks.focus_stacking import SharpestPlane

StackPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="STACK...",
        help="Planes of one scene at equal steps of the focus: a TIFF stack (also OME-TIFF, .lsm, "
        ".stk), OME-Zarr, a folder of pictures, or several pictures. Pictures are planes in the "
        "natural order of their names: slice2 comes before slice10.",
        show_default=False,
    ),
]
Channel = Annotated[
    int | None,
    typer.Option(
        metavar="NUMBER",
        help="Which channel to take, from 0; needed if STACK has several. Channels are never "
        "taken for planes.",
    ),
]
Time = Annotated[
    int | None,
    typer.Option(
        metavar="NUMBER",
        help="Which time to take, from 0; needed if STACK has several beside its planes.",
    ),
]
CompositeOutput = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write the picture of the sharpest pixels (.tif). "
        "[default: STACK-sharpest.tif, beside STACK]",
    ),
]
PositionOutput = Annotated[
    Path | None,
    typer.Option(
        metavar="PATH",
        help="Where to write the position of best focus of every pixel (.tif): planes from 0, "
        "and parts of planes.",
    ),
]
PositionConfidence = Annotated[
    Path | None,
    typer.Option(
        "--confidence",
        metavar="PATH",
        help="Where to write how sure the positions are (.tif): the probability that each is "
        "right to half a plane.",
    ),
]
PxPerPlane = Annotated[
    float | None,
    typer.Option(
        metavar="PX",
        help="By how many px the radius of the blur grows from plane to plane. It is found from "
        "the stack if left out.",
    ),
]


@dataclass(frozen=True)
class _Outputs:
    composite: Path
    position: Path | None
    confidence: Path | None

    @property
    def paths(self) -> list[Path]:
        """All that are wanted."""
        wanted = (self.composite, self.position, self.confidence)
        return [path for path in wanted if path is not None]


def sharpest(
    stack: StackPaths,
    *,
    channel: Channel = None,
    time: Time = None,
    px_per_plane: PxPerPlane = None,
    psf: PSFText = MapSettings.psf,
    noise_variance: NoiseVariance = MapSettings.noise_variance,
    max_radius: MaxRadius = MapSettings.max_radius,
    smoothness: MapSmoothness = MapSettings.smoothness,
    color_sigma: ColorSigma = MapSettings.color_sigma,
    linearize: LinearizeOption = MapSettings.linearize,
    intensity_range: IntensityRange = None,
    output: CompositeOutput = None,
    position: PositionOutput = None,
    confidence: PositionConfidence = None,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Find where each pixel of STACK is in focus, and make one picture of the sharpest."""

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.core.axes import focus_axis
        from napari_defocus.io.open import open_stack

        settings = MapSettings(
            psf=psf,
            noise_variance=noise_variance,
            max_radius=max_radius,
            smoothness=smoothness,
            color_sigma=color_sigma,
            linearize=linearize,
        )
        family = settings.family()
        given = (output, position, confidence)
        check_endings([path for path in given if path is not None], ".tif", ".tiff")
        source = open_stack(stack)
        outputs = _Outputs(output or _usual_output(source), position, confidence)
        focus = focus_axis(
            source.data.shape,
            source.axes,
            channel=channel,
            time=time,
            name=str(source.path),
            said=lambda argument: f"--{argument}",
        )
        for path in source.files:
            writing.check_results(outputs.paths, force=force, source=path)
        found = napari_defocus.sharpest_plane(
            source.data,
            axes=source.axes,
            channel=channel,
            time=time,
            px_per_plane=px_per_plane,
            psf=family,
            noise_variance=noise_variance,
            smoothness=smoothness,
            color_sigma=color_sigma,
            linearize=linearize,
            intensity_range=intensity_range,
            progress=progress,
        )
        facts = _facts(source, found, outputs) | _focus_facts(focus, channel, time)
        _write(outputs, source, found, facts | {"psf": psf, "smoothness": smoothness}, force)
        return facts

    run(measure, _lines, reporting)


def _usual_output(source: Source) -> Path:
    """Return where the picture goes: beside a stack, a folder of pictures, or their first."""
    if source.path in source.files:
        return beside(source.path, "-sharpest.tif")
    folder = source.path if source.path.name not in ("", "..") else source.path.resolve()
    return folder.with_name(f"{folder.name}-sharpest.tif")


def _write(
    outputs: _Outputs, source: Source, found: SharpestPlane, made: Mapping[str, Any], force: bool
) -> None:
    from napari_defocus.io.provenance import SHARPEST_PIXELS
    from napari_defocus.io.tiff_writer import write_pyramidal_tiff

    colors = "s" if source.axes.endswith("s") else ""
    wanted = (
        (outputs.composite, found.composite, f"yx{colors}", SHARPEST_PIXELS, ""),
        (outputs.position, found.position, "yx", "position of best focus", "planes"),
        (outputs.confidence, found.confidence, "yx", "confidence of the position", ""),
    )
    names = ("image", "channel", "time", "psf", "smoothness", "px_per_plane")
    used = {name: made[name] for name in names}
    for path, values, axes, quantity, unit in wanted:
        if path is not None:
            write_pyramidal_tiff(
                path,
                values,
                axes=axes,
                pixel_size={axis: size for axis, size in source.pixel_size.items() if axis in "yx"},
                units={axis: unit for axis, unit in source.units.items() if axis in "yx"},
                description={"quantity": quantity, "unit": unit, "settings": used},
                force=force,
            )


def _facts(source: Source, found: SharpestPlane, outputs: _Outputs) -> dict[str, Any]:
    import numpy as np

    height, width = found.position.shape
    known = np.isfinite(found.px_per_plane)
    return {
        "image": str(source.path),
        "pictures": [path.name for path in source.files] if len(source.files) > 1 else None,
        "width": width,
        "height": height,
        "planes": len(found.share_of_plane),
        "px_per_plane": float(found.px_per_plane) if known else None,
        "noise_variance": float(found.noise_variance),
        **intensity_facts(found.intensities),
        "best_plane": found.best,
        "share_of_plane": found.share_of_plane.tolist(),
        "confident_percent": 100.0 * float((found.confidence >= CONFIDENT).mean()),
        "files": [str(path) for path in outputs.paths],
    }


def _focus_facts(focus: FocusAxis, channel: int | None, time: int | None) -> dict[str, Any]:
    return {"channel": channel, "time": time, "focus_axis": focus.letter, "focus_note": focus.note}


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    size = f"{facts['width']} x {facts['height']} px"
    yield f"stack        {facts['image']}, {facts['planes']} planes of {size}"
    if facts["pictures"]:
        yield f"pictures     from {facts['pictures'][0]} to {facts['pictures'][-1]}"
    for name in ("channel", "time"):
        if facts[name] is not None:
            yield f"{name:<12} {facts[name]} (from 0)"
    if facts["focus_note"]:
        yield f"focus        {facts['focus_note']}"
    if facts.get("intensities"):
        yield f"intensities  {facts['intensities']}"
    if facts["px_per_plane"] is None:
        yield "blur         no texture to find by how much it grows from plane to plane"
    else:
        yield f"blur         grows by {facts['px_per_plane']:.2f} px from plane to plane"
    share = 100.0 * facts["share_of_plane"][facts["best_plane"]]
    yield f"sharpest     plane {facts['best_plane']} (from 0), on {share:.0f} % of the picture"
    yield (
        f"confidence   {CONFIDENT:g} or more on {facts['confident_percent']:.1f} % of the picture"
    )
    yield from last_lines(facts)
