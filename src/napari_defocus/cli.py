"""The terminal command: a blur map, an in-focus mask, and a demonstration."""

from __future__ import annotations

import json
import logging
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.progress import Progress, within
from napari_defocus.settings import MapSettings, MaskSettings, Mode, check_threshold
from napari_defocus.terminal import errors_in_one_line, print_result, progress_in_terminal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.candidates import BlurCandidates

CANDIDATES_SHARE = 0.7
"""Roughly how much of the time goes into the candidates; for the progress bar only."""

app = typer.Typer(
    name="napari-defocus",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ImagePath = Annotated[
    Path, typer.Argument(metavar="IMAGE", help="PNG, JPEG, TIFF, WebP or BMP.", show_default=False)
]
NoiseVariance = Annotated[
    float | None,
    typer.Option(
        metavar="NUMBER",
        help="Variance of the noise in the luminance, intensities from 0 to 1. "
        "Found from the picture if left out.",
    ),
]
MaxRadius = Annotated[
    float, typer.Option(metavar="PX", help="Largest blur radius that is looked for, in px.")
]
MapSmoothness = Annotated[
    float, typer.Option(metavar="NUMBER", help="Cost of a change of the radius by 0.1 px.")
]
MaskSmoothness = Annotated[
    float, typer.Option(metavar="NUMBER", help="Cost of the border of the mask.")
]
ColorSigma = Annotated[
    float,
    typer.Option(
        metavar="NUMBER",
        help="How much intensities (0 to 1) differ where the blur may change easily.",
    ),
]
ModeOption = Annotated[
    Mode,
    typer.Option(help="Weigh the whole likelihood curve, or the three candidates of the paper."),
]
Threshold = Annotated[
    float, typer.Option(metavar="PX", help="Largest radius that counts as in focus, in px.")
]
IntensityRange = Annotated[
    tuple[float, float] | None,
    typer.Option(
        metavar="LOW HIGH",
        help="Intensities that mean black and white, such as 0 4095 for 12-bit data. "
        "The range of the file's data type if left out; 0 to 1 for floats.",
    ),
]
MapOutputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write: values in px (.tif) or a drawing with a colour bar (.png). "
        "Can be given twice. [default: NAME-blur.tif and NAME-blur.png beside IMAGE]",
    ),
]
MaskOutput = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write the mask (.png): white in focus, black not. "
        "[default: NAME-mask.png beside IMAGE, and the overlay too]",
    ),
]
OverlayOutput = Annotated[
    Path | None,
    typer.Option(
        "--overlay",
        metavar="PATH",
        help="Where to write the picture with the rest dimmed (.png). "
        "[default: NAME-overlay.png beside IMAGE, and the mask too]",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results that exist.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print nothing but errors (and --json).")
]


def main() -> None:
    """Run the terminal command; the entry point of ``napari-defocus``."""
    _keep_libraries_quiet()
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


@app.command("map")
def map_picture(
    image: ImagePath,
    noise_variance: NoiseVariance = MapSettings.noise_variance,
    max_radius: MaxRadius = MapSettings.max_radius,
    smoothness: MapSmoothness = MapSettings.smoothness,
    color_sigma: ColorSigma = MapSettings.color_sigma,
    mode: ModeOption = MapSettings.mode,
    intensity_range: IntensityRange = None,
    output: MapOutputs = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Measure the blur radius, in px, at every pixel of IMAGE."""
    outputs = output or [_beside(image, "-blur.tif"), _beside(image, "-blur.png")]

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus import files

        settings = MapSettings(
            noise_variance=noise_variance,
            max_radius=max_radius,
            smoothness=smoothness,
            color_sigma=color_sigma,
            mode=mode,
        )
        _check_endings(outputs, ".tif", ".tiff", ".png")
        picture = files.read_picture(image)
        files.check_results(outputs, force=force, source=image)
        first, second = _shares(progress)
        candidates = _candidates(picture, settings, intensity_range, first)
        radius = _blur_map(candidates, picture, settings, intensity_range, second)
        files.write_results(_encoded_maps(outputs, radius, candidates, settings), force=force)
        return _facts(image, outputs, candidates) | _map_facts(radius)

    _run(measure, as_json, quiet)


@app.command("segment")
def segment_picture(
    image: ImagePath,
    threshold: Threshold = MaskSettings.threshold,
    noise_variance: NoiseVariance = MapSettings.noise_variance,
    max_radius: MaxRadius = MapSettings.max_radius,
    smoothness: MaskSmoothness = MaskSettings.smoothness,
    color_sigma: ColorSigma = MaskSettings.color_sigma,
    mode: ModeOption = MapSettings.mode,
    intensity_range: IntensityRange = None,
    output: MaskOutput = None,
    overlay: OverlayOutput = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find what is in focus in IMAGE."""
    if output is None and overlay is None:
        output, overlay = _beside(image, "-mask.png"), _beside(image, "-overlay.png")
    outputs = [path for path in (output, overlay) if path is not None]

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus import files

        settings = MapSettings(noise_variance=noise_variance, max_radius=max_radius, mode=mode)
        mask_settings = MaskSettings(
            threshold=threshold, smoothness=smoothness, color_sigma=color_sigma
        )
        check_threshold(threshold, max_radius)
        _check_endings(outputs, ".png")
        picture = files.read_picture(image)
        files.check_results(outputs, force=force, source=image)
        first, second = _shares(progress)
        candidates = _candidates(picture, settings, intensity_range, first)
        mask = _mask(candidates, picture, mask_settings, intensity_range, second)
        contents = _encoded_masks(output, overlay, picture, mask, intensity_range)
        files.write_results(contents, force=force)
        return _facts(image, outputs, candidates) | _mask_facts(mask)

    _run(measure, as_json, quiet)


@app.command("demo")
def demonstrate(
    folder: Annotated[
        Path, typer.Argument(metavar="[FOLDER]", help="Where to write; made if missing.")
    ] = Path("demo-output"),
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Measure a picture of ours; all results go into FOLDER.

    Running it again overwrites its results.
    """
    maps = [folder / "dandelion-blur.tif", folder / "dandelion-blur.png"]
    mask_path, overlay_path = folder / "dandelion-mask.png", folder / "dandelion-overlay.png"
    outputs = [*maps, mask_path, overlay_path]
    settings, mask_settings = MapSettings(), MaskSettings()

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus import files

        files.check_results(outputs, force=True)
        picture = files.read_picture(_sample())
        first, second = _shares(progress)
        candidates = _candidates(picture, settings, None, first)
        radius = _blur_map(candidates, picture, settings, None, within(second, 0.0, 0.5))
        mask = _mask(candidates, picture, mask_settings, None, within(second, 0.5, 1.0))
        contents = _encoded_maps(maps, radius, candidates, settings)
        contents |= _encoded_masks(mask_path, overlay_path, picture, mask, None)
        files.write_results(contents, force=True)
        facts = _facts(Path("dandelion.jpg"), outputs, candidates)
        return facts | _map_facts(radius) | _mask_facts(mask)

    def measure_into_folder(progress: Progress) -> dict[str, Any]:
        with _folder_for_results(folder):
            return measure(progress)

    _run(measure_into_folder, as_json, quiet)


def _run(measure: Callable[[Progress], dict[str, Any]], as_json: bool, quiet: bool) -> None:
    started = time.perf_counter()
    with errors_in_one_line():
        with progress_in_terminal(quiet) as progress:
            facts = measure(progress)
        facts["seconds"] = round(time.perf_counter() - started, 2)
        if as_json:
            print_result(json.dumps(facts))
        elif not quiet:
            print_result("\n".join(_lines(facts)))


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield f"picture      {facts['image']}, {facts['width']} x {facts['height']} px"
    variance, sigma = facts["noise_variance"], facts["noise_sigma_grey_levels"]
    yield f"noise        variance {variance:.2g} (sigma {sigma:.2f} of 255 grey levels)"
    if "radius_median_px" in facts:
        low, high = facts["radius_p5_px"], facts["radius_p95_px"]
        yield (
            f"blur radius  median {facts['radius_median_px']:.1f} px, "
            f"5 to 95 % of the picture: {low:.1f} to {high:.1f} px"
        )
    if "in_focus_percent" in facts:
        yield f"in focus     {facts['in_focus_percent']:.1f} % of the picture"
    yield f"time         {facts['seconds']:.1f} s"
    for path in facts["files"]:
        yield f"wrote        {path}"


def _facts(image: Path, outputs: list[Path], candidates: BlurCandidates) -> dict[str, Any]:
    height, width = candidates.image_shape
    return {
        "image": str(image),
        "width": width,
        "height": height,
        "noise_variance": candidates.noise_variance,
        "noise_sigma_grey_levels": 255.0 * candidates.noise_variance**0.5,
        "files": [str(path) for path in outputs],
    }


def _map_facts(radius: NDArray[Any]) -> dict[str, Any]:
    import numpy as np

    low, median, high = np.percentile(radius, [5, 50, 95])
    return {
        "radius_median_px": float(median),
        "radius_p5_px": float(low),
        "radius_p95_px": float(high),
    }


def _mask_facts(mask: NDArray[Any]) -> dict[str, Any]:
    return {"in_focus_percent": 100.0 * float((mask != 0).mean())}


def _shares(progress: Progress) -> tuple[Progress, Progress]:
    return within(progress, 0.0, CANDIDATES_SHARE), within(progress, CANDIDATES_SHARE, 1.0)


def _candidates(
    picture: NDArray[Any],
    settings: MapSettings,
    intensity_range: tuple[float, float] | None,
    progress: Progress,
) -> BlurCandidates:
    return napari_defocus.estimate_candidates(
        picture,
        psf=napari_defocus.Disc(settings.max_radius),
        noise_variance=settings.noise_variance,
        window=settings.window,
        stride=settings.stride,
        mode=settings.mode,
        intensity_range=intensity_range,
        progress=progress,
    )


def _blur_map(
    candidates: BlurCandidates,
    picture: NDArray[Any],
    settings: MapSettings,
    intensity_range: tuple[float, float] | None,
    progress: Progress,
) -> NDArray[Any]:
    return napari_defocus.label_blur_map(
        candidates,
        picture,
        smoothness=settings.smoothness,
        color_sigma=settings.color_sigma,
        intensity_range=intensity_range,
        progress=progress,
    )


def _mask(
    candidates: BlurCandidates,
    picture: NDArray[Any],
    settings: MaskSettings,
    intensity_range: tuple[float, float] | None,
    progress: Progress,
) -> NDArray[Any]:
    return napari_defocus.segment_in_focus(
        candidates,
        picture,
        threshold=settings.threshold,
        smoothness=settings.smoothness,
        color_sigma=settings.color_sigma,
        intensity_range=intensity_range,
        progress=progress,
    )


def _beside(image: Path, ending: str) -> Path:
    return image.parent / f"{image.stem}{ending}"


def _sample() -> Path:
    from importlib.resources import files

    return Path(str(files("napari_defocus") / "samples" / "dandelion.jpg"))


@contextmanager
def _folder_for_results(folder: Path) -> Iterator[None]:
    """Make the folder; take it away again if it is new and the work fails."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"cannot write into {folder}: it is no folder")
    if not folder.absolute().parent.is_dir():
        raise ValueError(f"cannot make {folder}: there is no folder {folder.parent}")
    new = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException:
        if new:
            folder.rmdir()
        raise


def _check_endings(outputs: list[Path], *endings: str) -> None:
    for path in outputs:
        if path.suffix.lower() not in endings:
            raise ValueError(f"cannot write {path}: its name must end in {' or '.join(endings)}")


def _encoded_maps(
    outputs: list[Path], radius: NDArray[Any], candidates: BlurCandidates, settings: MapSettings
) -> dict[Path, bytes]:
    from napari_defocus.files import blur_map_png, blur_map_tiff

    used = asdict(settings) | {"noise_variance": candidates.noise_variance}
    return {
        path: blur_map_png(radius, settings.max_radius)
        if path.suffix.lower() == ".png"
        else blur_map_tiff(radius, used)
        for path in outputs
    }


def _encoded_masks(
    output: Path | None,
    overlay: Path | None,
    picture: NDArray[Any],
    mask: NDArray[Any],
    intensity_range: tuple[float, float] | None,
) -> dict[Path, bytes]:
    from napari_defocus.files import mask_png, overlay_png

    contents = {output: mask_png(mask)} if output else {}
    if overlay:
        contents[overlay] = overlay_png(picture, mask, intensity_range)
    return contents
