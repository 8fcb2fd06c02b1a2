"""The terminal command: a blur map, an in-focus mask, a demonstration; see `lens_commands` too."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.cli import batch as batch_commands
from napari_defocus.cli import depth as depth_commands
from napari_defocus.cli import explain as explanation_commands
from napari_defocus.cli import lens as lens_commands
from napari_defocus.cli import restore as restoration_commands
from napari_defocus.cli import sample as sample_commands
from napari_defocus.cli import stack as stack_commands
from napari_defocus.cli.command import check_endings, last_lines, run
from napari_defocus.cli.console import end_as_after_ctrl_c
from napari_defocus.cli.option_groups import (
    EvidenceOptions,
    MapOptions,
    Reporting,
    SettingsFiles,
    with_groups,
)
from napari_defocus.cli.options import (
    ColorSigma,
    ConfidenceOutput,
    Force,
    ImagePath,
    LinearizeOption,
    MapOutputs,
    MaskOutput,
    MaskSmoothness,
    MinConfidence,
    OverlayOutput,
    PSFText,
    RegionsOutput,
    SeedsPath,
    ShotNoiseOption,
    Threshold,
)
from napari_defocus.cli.settings_options import SettingsCommand, saved_settings, with_settings
from napari_defocus.core.checks import check_confidence, check_threshold
from napari_defocus.core.progress import Progress, within
from napari_defocus.pipeline import (
    Measurement,
    beside,
    label_map,
    lines_of,
    map_facts,
    measure_candidates,
    measure_map,
    picture_facts,
    shares,
    used,
)
from napari_defocus.settings import MapSettings, MaskSettings, usual_threshold

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.labeling.regions import RegionTable
    from napari_defocus.likelihood.candidates import BlurCandidates

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


@app.command("map", cls=SettingsCommand)
@with_groups
def map_picture(
    image: ImagePath,
    *,
    measuring: MapOptions,
    output: MapOutputs = None,
    confidence: ConfidenceOutput = None,
    min_confidence: MinConfidence = 0.0,
    settings_files: SettingsFiles,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Measure how wide the blur is, in px, at every pixel of IMAGE."""
    maps = output or [beside(image, "-blur.tif"), beside(image, "-blur.png")]
    outputs = [*maps, *([confidence] if confidence else [])]

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures

        settings = measuring.settings()
        check_confidence("min_confidence", min_confidence)
        check_endings(outputs, ".tif", ".tiff", ".png")
        picture = pictures.read_picture(image)
        writing.check_results(
            with_settings(outputs, settings_files.save_settings), force=force, source=image
        )
        found = measure_map(picture, settings, measuring.intensity_range, progress)
        facts = picture_facts(image, outputs, found, settings) | map_facts(found, min_confidence)
        contents = _encoded_maps(maps, found, min_confidence, settings)
        contents |= _encoded_confidence(confidence, found, settings)
        contents |= saved_settings(
            settings_files.save_settings, "map", napari_defocus.Settings(map=settings)
        )
        writing.write_results(contents, force=force)
        return facts

    run(measure, _lines, reporting)


@app.command("segment", cls=SettingsCommand)
@with_groups
def segment_picture(
    image: ImagePath,
    *,
    threshold: Threshold = None,
    measuring: EvidenceOptions,
    smoothness: MaskSmoothness = MaskSettings.smoothness,
    color_sigma: ColorSigma = MaskSettings.color_sigma,
    seeds: SeedsPath = None,
    output: MaskOutput = None,
    overlay: OverlayOutput = None,
    regions: RegionsOutput = None,
    settings_files: SettingsFiles,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Find what is in focus in IMAGE."""
    if output is None and overlay is None:
        output, overlay = beside(image, "-mask.png"), beside(image, "-overlay.png")
    drawings = [path for path in (output, overlay) if path is not None]
    tables = [regions] if regions else []
    outputs = [*drawings, *tables]
    intensity_range = measuring.intensity_range

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures

        settings = measuring.settings()
        family = settings.family()
        mask_settings = MaskSettings(
            threshold=usual_threshold(family) if threshold is None else threshold,
            smoothness=smoothness,
            color_sigma=color_sigma,
        )
        check_threshold(mask_settings.threshold, family.max_scale)
        check_endings(drawings, ".png")
        check_endings(tables, ".csv")
        picture = pictures.read_picture(image)
        known = _seeds(seeds, picture)
        for source in (image, seeds):
            writing.check_results(
                with_settings(outputs, settings_files.save_settings), force=force, source=source
            )
        first, second = shares(progress)
        candidates = measure_candidates(picture, settings, intensity_range, first)
        third = within(second, 0.5 if regions else 1.0, 1.0)
        second = within(second, 0.0, 0.5 if regions else 1.0)
        mask = _mask(candidates, picture, mask_settings, intensity_range, second, known)
        contents = _encoded_masks(output, overlay, picture, mask, intensity_range)
        used_settings = napari_defocus.Settings(map=settings, mask=mask_settings)
        contents |= saved_settings(settings_files.save_settings, "segment", used_settings)
        facts = picture_facts(image, outputs, candidates, settings) | _mask_facts(mask)
        facts |= _seeds_facts(seeds, known)
        if regions:
            found = label_map(candidates, picture, settings, intensity_range, third)
            table = _region_table(mask, found)
            contents[regions] = table.as_csv()
            facts |= {"regions": len(table) - 1}
        writing.write_results(contents, force=force)
        return facts

    run(measure, _lines, reporting)


@app.command("demo")
@with_groups
def demonstrate(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Where to write; made if missing.")
    ] = Path("demo-output"),
    *,
    psf: PSFText = MapSettings.psf,
    shot_noise: ShotNoiseOption = MapSettings.shot_noise,
    linearize: LinearizeOption = MapSettings.linearize,
    reporting: Reporting,
) -> None:
    """Measure a picture of ours; all results go into FOLDER.

    Running it again overwrites its results.
    """
    maps = [folder / "dandelion-blur.tif", folder / "dandelion-blur.png"]
    mask_path, overlay_path = folder / "dandelion-mask.png", folder / "dandelion-overlay.png"
    confidence_path = folder / "dandelion-confidence.png"
    outputs = [*maps, confidence_path, mask_path, overlay_path]

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures

        settings = MapSettings(psf=psf, shot_noise=shot_noise, linearize=linearize)
        family = settings.family()
        mask_settings = MaskSettings(threshold=usual_threshold(family))
        check_threshold(mask_settings.threshold, family.max_scale)
        writing.check_results(outputs, force=True)
        picture = pictures.read_picture(sample_commands.sample_path("dandelion"))
        first, second = shares(progress)
        candidates = measure_candidates(picture, settings, None, first)
        found = label_map(candidates, picture, settings, None, within(second, 0.0, 0.5))
        mask = _mask(candidates, picture, mask_settings, None, within(second, 0.5, 1.0))
        contents = _encoded_maps(maps, found, 0.0, settings)
        contents |= _encoded_confidence(confidence_path, found, settings)
        contents |= _encoded_masks(mask_path, overlay_path, picture, mask, None)
        writing.write_results(contents, force=True)
        facts = picture_facts(Path("dandelion.jpg"), outputs, found, settings)
        return facts | map_facts(found) | _mask_facts(mask)

    def measure_into_folder(progress: Progress) -> dict[str, Any]:
        with _folder_for_results(folder):
            return measure(progress)

    run(measure_into_folder, _lines, reporting)


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield from lines_of(facts)
    if "in_focus_percent" in facts:
        yield f"in focus     {facts['in_focus_percent']:.1f} % of the picture"
    if "regions" in facts:
        yield f"regions      {facts['regions']} in focus"
    if facts.get("seeds"):
        known = facts["seeds"]
        yield (
            f"seeds        {known['in_focus_px']} px in focus, {known['blurred_px']} px blurred, "
            f"from {known['file']}"
        )
    yield from last_lines(facts)


def _mask_facts(mask: NDArray[Any]) -> dict[str, Any]:
    return {"in_focus_percent": 100.0 * float((mask != 0).mean())}


def _region_table(mask: NDArray[Any], found: Measurement) -> RegionTable:
    _, table = napari_defocus.measure_regions(mask, found.blur_map, found.confidence)
    return table


def _seeds(path: Path | None, picture: NDArray[Any]) -> NDArray[Any] | None:
    if path is None:
        return None
    from napari_defocus.io.pictures import read_picture
    from napari_defocus.labeling.seeds import checked_seeds

    return checked_seeds(read_picture(path), picture.shape[:2])


def _seeds_facts(path: Path | None, seeds: NDArray[Any] | None) -> dict[str, Any]:
    if seeds is None:
        return {"seeds": None}
    from napari_defocus.labeling.seeds import BLURRED, IN_FOCUS

    known = {"in_focus_px": int((seeds == IN_FOCUS).sum())}
    known["blurred_px"] = int((seeds == BLURRED).sum())
    return {"seeds": {"file": str(path), **known}}


def _mask(
    candidates: BlurCandidates,
    picture: NDArray[Any],
    settings: MaskSettings,
    intensity_range: tuple[float, float] | None,
    progress: Progress,
    seeds: NDArray[Any] | None = None,
) -> NDArray[Any]:
    return napari_defocus.segment_in_focus(
        candidates,
        picture,
        threshold=settings.threshold,
        smoothness=settings.smoothness,
        color_sigma=settings.color_sigma,
        seeds=seeds,
        intensity_range=intensity_range,
        progress=progress,
    )


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


def _encoded_maps(
    outputs: list[Path], found: Measurement, min_confidence: float, settings: MapSettings
) -> dict[Path, bytes]:
    from napari_defocus.io.encoders import blur_map_png, blur_map_tiff

    trusted = found.trusted(min_confidence)
    made_with = used(found, settings) | {"min_confidence": min_confidence}
    psf = found.psf
    return {
        path: blur_map_png(trusted, psf.max_scale, psf.scale_name, min_confidence)
        if path.suffix.lower() == ".png"
        else blur_map_tiff(trusted, made_with, psf.scale_name)
        for path in outputs
    }


def _encoded_confidence(
    output: Path | None, found: Measurement, settings: MapSettings
) -> dict[Path, bytes]:
    from napari_defocus.io.encoders import confidence_png, confidence_tiff

    if output is None or found.confidence is None:
        return {}
    if output.suffix.lower() == ".png":
        return {output: confidence_png(found.confidence)}
    return {output: confidence_tiff(found.confidence, used(found, settings))}


def _encoded_masks(
    output: Path | None,
    overlay: Path | None,
    picture: NDArray[Any],
    mask: NDArray[Any],
    intensity_range: tuple[float, float] | None,
) -> dict[Path, bytes]:
    from napari_defocus.io.encoders import mask_png, overlay_png

    contents = {output: mask_png(mask)} if output else {}
    if overlay:
        contents[overlay] = overlay_png(picture, mask, intensity_range)
    return contents


app.command("sample")(with_groups(sample_commands.sample))
app.command("restore", cls=SettingsCommand)(with_groups(restoration_commands.restore))
app.command("refocus", cls=SettingsCommand)(with_groups(restoration_commands.refocus))
app.command("batch", cls=SettingsCommand)(with_groups(batch_commands.batch))
app.command("depth", cls=SettingsCommand)(with_groups(depth_commands.depth))
app.command("explain", cls=SettingsCommand)(with_groups(explanation_commands.explain))
app.command("sharpest")(with_groups(stack_commands.sharpest))
app.command("calibrate")(with_groups(lens_commands.calibrate))
app.command("compare-psf")(with_groups(lens_commands.compare))
