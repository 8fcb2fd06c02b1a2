"""The terminal command for a stack through focus: which plane is sharp where, and one picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.commands import check_endings, last_lines, run
from napari_defocus.measurement import beside, intensity_facts
from napari_defocus.option_groups import Reporting
from napari_defocus.options import (
    ColorSigma,
    Force,
    IntensityRange,
    LinearizeOption,
    MapSmoothness,
    MaxRadius,
    NoiseVariance,
    PSFText,
)
from napari_defocus.progress import Progress
from napari_defocus.settings import CONFIDENT, MapSettings

if TYPE_CHECKING:
    from napari_defocus.sharpest import SharpestPlane
    from napari_defocus.sources import Source

StackPath = Annotated[
    Path,
    typer.Argument(
        metavar="STACK",
        help="Planes of one scene at equal steps of the focus: a TIFF stack or OME-Zarr.",
    ),
]
CompositeOutput = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write the picture of the sharpest pixels (.tif). "
        "[default: STACK-sharpest.tif]",
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
    stack: StackPath,
    *,
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
    outputs = _Outputs(output or beside(stack, "-sharpest.tif"), position, confidence)

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus import files
        from napari_defocus.sources import open_source

        settings = MapSettings(
            psf=psf,
            noise_variance=noise_variance,
            max_radius=max_radius,
            smoothness=smoothness,
            color_sigma=color_sigma,
            linearize=linearize,
        )
        family = settings.family()
        check_endings(outputs.paths, ".tif", ".tiff")
        source = _only_stack(open_source(stack))
        files.check_results(outputs.paths, force=force, source=stack)
        found = napari_defocus.sharpest_plane(
            source.data,
            axes=source.axes,
            px_per_plane=px_per_plane,
            psf=family,
            noise_variance=noise_variance,
            smoothness=smoothness,
            color_sigma=color_sigma,
            linearize=linearize,
            intensity_range=intensity_range,
            progress=progress,
        )
        facts = _facts(source, found, outputs)
        _write(outputs, source, found, facts | {"psf": psf, "smoothness": smoothness}, force)
        return facts

    run(measure, _lines, reporting)


def _only_stack(source: Source) -> Source:
    planes = dict(zip(source.plane_axes, source.plane_shape, strict=True))
    if len(planes) != 1:
        held = " and ".join(f"{size} along {axis}" for axis, size in planes.items())
        raise ValueError(
            f"{source.path} has {f'planes, {held}' if held else 'a single plane'}; "
            "it takes planes along one axis"
        )
    return source


def _write(
    outputs: _Outputs, source: Source, found: SharpestPlane, made: Mapping[str, Any], force: bool
) -> None:
    from napari_defocus.tiff_stacks import write_pyramidal_tiff

    colors = "s" if source.axes.endswith("s") else ""
    wanted = (
        (outputs.composite, found.composite, f"yx{colors}", "picture of the sharpest pixels", ""),
        (outputs.position, found.position, "yx", "position of best focus", "planes"),
        (outputs.confidence, found.confidence, "yx", "confidence of the position", ""),
    )
    used = {name: made[name] for name in ("image", "psf", "smoothness", "px_per_plane")}
    for path, values, axes, quantity, unit in wanted:
        if path is not None:
            write_pyramidal_tiff(
                path,
                values,
                axes=axes,
                scale={axis: size for axis, size in source.scale.items() if axis in "yx"},
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


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    size = f"{facts['width']} x {facts['height']} px"
    yield f"stack        {facts['image']}, {facts['planes']} planes of {size}"
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
