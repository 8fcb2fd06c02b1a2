"""The terminal commands that make pictures: all in focus, and with another focus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import lines_of, map_facts, picture_facts
from napari_defocus.cli.option_groups import MapOrFileOptions, RestorationOptions
from napari_defocus.cli.options import Encoding
from napari_defocus.cli.results import Files, beside, check_endings, encoded, encoded_left
from napari_defocus.cli.thin_lens import (
    LensOptions,
    check_change,
    focus_facts,
    lens_line,
    side_line,
)
from napari_defocus.core.checks import Linearize, Side
from napari_defocus.core.progress import Progress, within
from napari_defocus.pipeline import Measurement, file_facts, intensities_of, used
from napari_defocus.pipeline import restore as restored
from napari_defocus.settings import MapSettings, RefocusSettings, RestorationSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.restoration.all_in_focus import RestorationFit

MEASURING_SHARE = 0.2
"""Roughly how much of the time goes into the map; for the progress bar only."""

_RESTORING_SHARE = 0.8
"""The share of the time after the map, roughly."""

_OUTPUTS = """
output -o PATH
    Where to write: a picture of 8 bits, or 16 if IMAGE has more (.png), or float32 from 0 to 1
    (.tif). Can be given twice. [default: NAME-{}.png beside IMAGE]
"""


_LEFT = """
left_as_it_was PATH
    Where to write how far each pixel was left as it was, because it would get rings: values from 0,
    restored, to 1 (.tif) or a drawing (.png).
"""

_LEAST_PERCENT = 0.5
"""Of the picture: less is not worth a line."""


def _weight_line(facts: Facts) -> str:
    line = f"smoothing    {facts['tv_weight']:.2g} (--tv-weight)"
    if facts["misfit"] > 0:
        line += ", more than for noise alone: the lens or the map may not fit"
    return line


def _unrestored_lines(facts: Facts) -> Iterator[str]:
    percent = 100 * facts["unrestored"]
    if percent >= _LEAST_PERCENT:
        yield f"not restored {percent:.0f} % of the picture: it would get rings there"


def _restored_lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    yield _weight_line(facts)
    yield from _unrestored_lines(facts)
    yield from last_lines(facts)


def _refocused_lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    yield _weight_line(facts)
    yield from _unrestored_lines(facts)
    if "thin_lens" in facts:
        yield lens_line(facts)
    yield side_line(facts)
    where = f", {facts['sharp_at_m']} m away" if "sharp_at_m" in facts else ""
    focus = facts["focus_px"]
    other = " on the other side" if focus < 0 else ""
    yield f"sharp now    what is blurred by {abs(focus):.1f} px{other}{where}"
    yield f"aperture     {facts['aperture']:g} times as wide"
    yield f"encoding     {facts['encoding']}"
    yield from last_lines(facts)


@command(_restored_lines, _OUTPUTS.format("in-focus") + _LEFT)
def restore(
    image: Path,
    *,
    restoring: RestorationOptions,
    measuring: MapOrFileOptions,
    output: list[Path] | None = None,
    left_as_it_was: Path | None = None,
    files: Files,
    progress: Progress,
) -> dict[str, Any]:
    """Bring all of IMAGE into focus, as far as noise allows."""
    from napari_defocus.io.provenance import ALL_IN_FOCUS

    outputs = output or beside(image, "-in-focus.png")
    settings, asked = measuring.settings(image), restoring.settings()
    intensity_range = measuring.intensity_range
    lefts = [left_as_it_was] if left_as_it_was else []
    written = [*outputs, *lefts]
    check_endings(written, ".png", ".tif", ".tiff")
    picture = files.read(image, written, *measuring.files)
    first, second = _shares(progress)
    found = measuring.find(picture, settings, first)
    if found.intensities is None:
        found = replace(found, intensities=intensities_of(picture, intensity_range))
    sharp, fit = _all_in_focus(
        picture, found, settings, asked, settings.linearize, intensity_range, second
    )
    found = replace(found, noise_variance=fit.noise_variance)
    shaping = {"tv_weight": fit.tv_weight, "misfit": fit.misfit, "unrestored": fit.unrestored}
    facts = picture_facts(image, picture, written, found, settings) | file_facts(found)
    facts |= map_facts(found) | shaping
    made_with = used(found, settings) | shaping | {"risk": asked.risk}
    contents = _encoded(outputs, sharp, picture, ALL_IN_FOCUS, made_with)
    contents |= encoded_left(lefts, fit, made_with)
    files.write(contents, "restore", map=settings, restoration=asked)
    return facts


@command(
    _refocused_lines,
    _OUTPUTS.format("refocused")
    + _LEFT
    + f"""
focus PX
    Make sharp what is blurred by so many px, in the scale of --psf and the map. A negative number
    means the other side of the focus than --side.
    [default: {RefocusSettings.focus:g}, the focus stays]
sharp_at M
    Make sharp what is so far away, in m, instead of --focus. It needs the lens: --focal-length,
    --f-number, --focus-distance and --pixel-pitch, unless IMAGE notes them.
aperture FACTOR
    How many times as wide the aperture, and so the blur, will be: 2 for two stops more, 0 for
    everything in focus.
encoding
    How IMAGE holds light: srgb if a camera made it for screens, linear if its numbers are
    proportional to light, as those of microscopes and raw data. IMAGE is restored and blurred again
    in linear light. --noise-variance counts there if --linearize is the same or --map is given.
    Otherwise the noise is found again.
""",
)
def refocus(
    image: Path,
    *,
    focus: float | None = None,
    sharp_at: float | None = None,
    aperture: float = RefocusSettings.aperture,
    side: Side = RefocusSettings.side,
    encoding: Encoding = RefocusSettings.linearize or "linear",
    thin_lens: LensOptions,
    restoring: RestorationOptions,
    measuring: MapOrFileOptions,
    output: list[Path] | None = None,
    left_as_it_was: Path | None = None,
    files: Files,
    progress: Progress,
) -> dict[str, Any]:
    """Show IMAGE with another focus or another aperture.

    --focus or --sharp-at says what becomes sharp, --aperture how blurred the rest becomes.
    """
    from napari_defocus.io.provenance import REFOCUSED

    outputs = output or beside(image, "-refocused.png")
    settings, asked = measuring.settings(image), restoring.settings()
    intensity_range = measuring.intensity_range
    check_change(focus, sharp_at, aperture, thin_lens)
    lefts = [left_as_it_was] if left_as_it_was else []
    written = [*outputs, *lefts]
    check_endings(written, ".png", ".tif", ".tiff")
    picture = files.read(image, written, *measuring.files)
    change = focus_facts(image, focus, sharp_at, side, thin_lens)
    change |= {"aperture": aperture, "side": side, "encoding": encoding}
    first, second = _shares(progress)
    found = measuring.find(picture, settings, first)
    if found.intensities is None:
        found = replace(found, intensities=intensities_of(picture, intensity_range))
    light: Linearize | None = "srgb" if encoding == "srgb" else None
    restored = within(second, 0.0, _RESTORING_SHARE)
    sharp, fit = _all_in_focus(
        picture, _sure(found), settings, asked, light, intensity_range, restored
    )
    change["restoring_noise_variance"] = fit.noise_variance
    change |= {"tv_weight": fit.tv_weight, "misfit": fit.misfit, "unrestored": fit.unrestored}
    change |= {"risk": asked.risk}
    view = RefocusSettings(focus=change["focus_px"], aperture=aperture, side=side, linearize=light)
    changed = napari_defocus.change_focus(
        picture,
        _without_gaps(found).blur_map,
        **asdict(view),
        psf=found.psf,
        all_in_focus=sharp,
        intensity_range=intensity_range,
        progress=within(second, _RESTORING_SHARE, 1.0),
    )
    made_with = used(found, settings) | change
    contents = _encoded(outputs, changed, picture, REFOCUSED, made_with)
    contents |= encoded_left(lefts, fit, made_with)
    files.write(contents, "refocus", map=settings, restoration=asked, refocus=view)
    facts = picture_facts(image, picture, written, found, settings) | file_facts(found)
    return facts | map_facts(found) | change


def _shares(progress: Progress) -> tuple[Progress, Progress]:
    return within(progress, 0.0, MEASURING_SHARE), within(progress, MEASURING_SHARE, 1.0)


def _all_in_focus(
    picture: NDArray[Any],
    found: Measurement,
    settings: MapSettings,
    asked: RestorationSettings,
    light: Linearize | None,
    intensity_range: tuple[float, float] | None,
    progress: Progress,
) -> tuple[NDArray[Any], RestorationFit]:
    """Return the picture without what is safe to take away, and how well it fits.

    The noise variance is that in the light in which the picture is restored.
    """
    from napari_defocus.restoration.all_in_focus import Restoration

    noise = found.noise_variance
    if noise is None or (light != settings.linearize and found.map_file is None):
        noise = napari_defocus.estimate_noise_variance(
            picture, linearize=light, intensity_range=intensity_range
        )
    safe = _without_gaps(replace(found, blur_map=found.cautious(asked.risk)))
    how = Restoration(found.psf, noise, asked.tv_weight, light, intensity_range)
    return restored(picture, safe.blur_map, safe.confidence, how, progress=progress)


def _encoded(
    outputs: list[Path],
    made: NDArray[Any],
    picture: NDArray[Any],
    quantity: str,
    made_with: Mapping[str, Any],
) -> dict[Path, bytes]:
    from napari_defocus.io.encoders import picture_png, picture_tiff, with_opacity

    shown = with_opacity(made, picture)
    return encoded(
        outputs,
        lambda: picture_png(shown, picture, quantity),
        lambda: picture_tiff(shown, quantity, made_with),
    )


def _sure(found: Measurement) -> Measurement:
    """Return full confidence where none is known, as `change_focus` has it."""
    import numpy as np

    if found.confidence is not None:
        return found
    return replace(found, confidence=np.ones(found.image_shape, np.float32))


def _without_gaps(found: Measurement) -> Measurement:
    """Return the scale of the nearest known pixel, with no confidence, where it is not known."""
    import numpy as np
    from scipy.ndimage import distance_transform_edt

    unknown = np.isnan(found.blur_map)
    if not unknown.any():
        return found
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    sure = np.float32(1) if found.confidence is None else found.confidence
    return replace(
        found,
        blur_map=found.blur_map[tuple(nearest)],
        confidence=np.where(unknown, np.float32(0), sure),
    )
