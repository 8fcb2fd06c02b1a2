"""The terminal commands that make pictures: all in focus, and with another focus."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.command import check_endings, last_lines, run
from napari_defocus.cli.depth import (
    check_side,
    lens_facts,
    lens_line,
    lens_of,
    side_line,
)
from napari_defocus.cli.option_groups import (
    LensOptions,
    MapOrFileOptions,
    Reporting,
    SettingsFiles,
)
from napari_defocus.cli.options import (
    Aperture,
    Encoding,
    EncodingOption,
    FocusOption,
    Force,
    ImagePath,
    RefocusedOutputs,
    RestoredOutputs,
    Risk,
    SharpAt,
    SideOption,
    TVWeight,
)
from napari_defocus.cli.settings_options import saved_settings, with_settings
from napari_defocus.core.checks import Linearize, Side, check_risk, check_tv_weight
from napari_defocus.core.progress import Progress, within
from napari_defocus.pipeline import (
    Measurement,
    beside,
    file_facts,
    find_blur,
    intensities_of,
    lines_of,
    map_facts,
    picture_facts,
    used,
)
from napari_defocus.settings import MapSettings, RefocusSettings, RestorationSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.psf.families import PSFFamily

MEASURING_SHARE = 0.2
"""Roughly how much of the time goes into the map; for the progress bar only."""

_RESTORING_SHARE = 0.8
"""Of the time after the map, roughly."""

_USUAL_ENCODING: Encoding = RefocusSettings.linearize or "linear"


def restore(
    image: ImagePath,
    *,
    tv_weight: TVWeight = RestorationSettings.tv_weight,
    risk: Risk = RestorationSettings.risk,
    measuring: MapOrFileOptions,
    output: RestoredOutputs = None,
    settings_files: SettingsFiles,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Bring all of IMAGE into focus, as far as its blur and its noise allow."""
    outputs = output or [beside(image, "-in-focus.png")]
    intensity_range = measuring.intensity_range
    known_map, map_confidence = measuring.known_map, measuring.map_confidence

    def work(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures
        from napari_defocus.io.provenance import ALL_IN_FOCUS

        settings = measuring.settings()
        check_tv_weight(tv_weight)
        check_risk(risk)
        check_endings(outputs, ".png", ".tif", ".tiff")
        picture = pictures.read_picture(image)
        for source in (image, known_map, map_confidence):
            writing.check_results(
                with_settings(outputs, settings_files.save_settings), force=force, source=source
            )
        first, second = _shares(progress)
        found = find_blur(picture, settings, intensity_range, known_map, map_confidence, first)
        noise = _noise_variance(found, picture, settings, settings.linearize, intensity_range)
        found = replace(found, noise_variance=noise)
        found = _with_intensities(found, picture, intensity_range)
        weight = _weight(tv_weight, noise, found, picture)
        facts = picture_facts(image, outputs, found, settings)
        facts |= file_facts(found) | map_facts(found) | {"tv_weight": weight}
        sharp = _restored(
            picture, found, noise, weight, risk, settings.linearize, intensity_range, second
        )
        made_with = used(found, settings) | {"tv_weight": weight, "risk": risk}
        contents = _encoded(outputs, sharp, picture, ALL_IN_FOCUS, made_with)
        restoration = RestorationSettings(tv_weight=tv_weight, risk=risk)
        used_settings = napari_defocus.Settings(map=settings, restoration=restoration)
        contents |= saved_settings(settings_files.save_settings, "restore", used_settings)
        writing.write_results(contents, force=force)
        return facts

    run(work, _restored_lines, reporting)


def refocus(
    image: ImagePath,
    *,
    focus: FocusOption = None,
    sharp_at: SharpAt = None,
    aperture: Aperture = RefocusSettings.aperture,
    side: SideOption = RefocusSettings.side,
    encoding: EncodingOption = _USUAL_ENCODING,
    thin_lens: LensOptions,
    tv_weight: TVWeight = RestorationSettings.tv_weight,
    risk: Risk = RestorationSettings.risk,
    measuring: MapOrFileOptions,
    output: RefocusedOutputs = None,
    settings_files: SettingsFiles,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Show IMAGE as if it had been focused elsewhere, or with another aperture.

    --focus or --sharp-at says what shall be sharp, --aperture how blurred the rest.
    """
    outputs = output or [beside(image, "-refocused.png")]
    intensity_range = measuring.intensity_range
    known_map, map_confidence = measuring.known_map, measuring.map_confidence

    def work(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures
        from napari_defocus.io.provenance import REFOCUSED

        settings = measuring.settings()
        family = settings.family()
        check_tv_weight(tv_weight)
        check_risk(risk)
        _check_change(focus, sharp_at, aperture, thin_lens)
        check_endings(outputs, ".png", ".tif", ".tiff")
        picture = pictures.read_picture(image)
        change = _focus_facts(image, focus, sharp_at, side, thin_lens, family)
        change |= {"aperture": aperture, "side": side, "encoding": encoding}
        for source in (image, known_map, map_confidence):
            writing.check_results(
                with_settings(outputs, settings_files.save_settings), force=force, source=source
            )
        first, second = _shares(progress)
        found = find_blur(picture, settings, intensity_range, known_map, map_confidence, first)
        light: Linearize | None = "srgb" if encoding == "srgb" else None
        noise = _noise_variance(found, picture, settings, light, intensity_range)
        found = _with_intensities(found, picture, intensity_range)
        weight = _weight(tv_weight, noise, found, picture)
        change |= {"restoring_noise_variance": noise, "tv_weight": weight, "risk": risk}
        facts = picture_facts(image, outputs, found, settings)
        facts |= file_facts(found) | map_facts(found) | change
        restoring = within(second, 0.0, _RESTORING_SHARE)
        sharp = _restored(
            picture, _sure(found), noise, weight, risk, light, intensity_range, restoring
        )
        changed = napari_defocus.change_focus(
            picture,
            _without_gaps(found).blur_map,
            focus=change["focus_px"],
            aperture=aperture,
            side=side,
            psf=found.psf,
            all_in_focus=sharp,
            linearize=light,
            intensity_range=intensity_range,
            progress=within(second, _RESTORING_SHARE, 1.0),
        )
        made_with = used(found, settings) | change
        contents = _encoded(outputs, changed, picture, REFOCUSED, made_with)
        used_settings = napari_defocus.Settings(
            map=settings,
            restoration=RestorationSettings(tv_weight=tv_weight, risk=risk),
            refocus=RefocusSettings(
                focus=change["focus_px"], aperture=aperture, side=side, linearize=light
            ),
        )
        contents |= saved_settings(settings_files.save_settings, "refocus", used_settings)
        writing.write_results(contents, force=force)
        return facts

    run(work, _refocused_lines, reporting)


def _shares(progress: Progress) -> tuple[Progress, Progress]:
    return within(progress, 0.0, MEASURING_SHARE), within(progress, MEASURING_SHARE, 1.0)


def _restored(
    picture: NDArray[Any],
    found: Measurement,
    noise_variance: float,
    tv_weight: float,
    risk: float,
    linearize: Linearize | None,
    intensity_range: tuple[float, float] | None,
    progress: Progress,
) -> NDArray[Any]:
    """Take away what is safe to take away."""
    safe = _without_gaps(replace(found, blur_map=found.cautious(risk)))
    return napari_defocus.restore_all_in_focus(
        picture,
        safe.blur_map,
        psf=found.psf,
        noise_variance=noise_variance,
        confidence=safe.confidence,
        tv_weight=tv_weight,
        linearize=linearize,
        intensity_range=intensity_range,
        progress=progress,
    )


def _check_change(
    focus: float | None, sharp_at: float | None, aperture: float, thin_lens: LensOptions
) -> None:
    """Check what shall change, as far as that goes without the lens."""
    if focus is not None and sharp_at is not None:
        raise ValueError(f"focus is {focus} and sharp_at is {sharp_at}; one of them is enough")
    if sharp_at is None:
        for name, value in thin_lens.given.items():
            if value is not None:
                raise ValueError(f"{name} is {value}, but only sharp_at takes a lens")
        if focus in (None, RefocusSettings.focus) and aperture == RefocusSettings.aperture:
            raise ValueError("nothing would change; give focus, sharp_at or aperture")
    elif not sharp_at > 0:
        raise ValueError(f"sharp_at is {sharp_at}; it takes a distance above 0 m")
    if focus is not None and not math.isfinite(focus):
        raise ValueError(f"focus is {focus}; it takes a finite number of px")
    if not 0 <= aperture < math.inf:
        raise ValueError(f"aperture is {aperture}; it takes a finite number from 0 up")


def _focus_facts(
    image: Path,
    focus: float | None,
    sharp_at: float | None,
    side: Side,
    thin_lens: LensOptions,
    psf: PSFFamily,
) -> dict[str, Any]:
    """Return the blur of what shall be sharp, and how it was found."""
    if sharp_at is None:
        return {"focus_px": RefocusSettings.focus if focus is None else focus}
    lens = lens_of(image, thin_lens)
    check_side(side, lens)
    blur = float(napari_defocus.blur_from_depth(sharp_at, lens, psf=psf))
    if not math.isfinite(blur):
        raise ValueError(f"sharp_at is {sharp_at}; nothing so near can be made sharp")
    beyond = sharp_at > lens.focus_distance_m
    told = {"sharp_at_m": sharp_at if math.isfinite(sharp_at) else "inf"}
    return (
        {"focus_px": blur if beyond == (side == "far") else -blur}
        | told
        | lens_facts(lens, thin_lens)
    )


def _noise_variance(
    found: Measurement,
    picture: NDArray[Any],
    settings: MapSettings,
    linearize: Linearize | None,
    intensity_range: tuple[float, float] | None,
) -> float:
    """Return the noise variance in the light in which the picture is restored."""
    same_light = linearize == settings.linearize or found.map_file is not None
    if found.noise_variance is not None and same_light:
        return found.noise_variance
    return napari_defocus.estimate_noise_variance(
        picture, linearize=linearize, intensity_range=intensity_range
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


def _encoded(
    outputs: list[Path],
    made: NDArray[Any],
    picture: NDArray[Any],
    quantity: str,
    made_with: Mapping[str, Any],
) -> dict[Path, bytes]:
    from napari_defocus.io.encoders import picture_png, picture_tiff, with_opacity

    shown = with_opacity(made, picture)
    return {
        path: picture_png(shown, picture, quantity)
        if path.suffix.lower() == ".png"
        else picture_tiff(shown, quantity, made_with)
        for path in outputs
    }


def _with_intensities(
    found: Measurement, picture: NDArray[Any], intensity_range: tuple[float, float] | None
) -> Measurement:
    """Return the same with the intensities that the picture is restored in."""
    if found.intensities is not None:
        return found
    return replace(found, intensities=intensities_of(picture, intensity_range))


def _weight(
    tv_weight: float | None, noise_variance: float, found: Measurement, picture: NDArray[Any]
) -> float:
    """Return the lambda that is given, or the usual one."""
    if tv_weight is not None:
        return tv_weight
    from napari_defocus.restoration.all_in_focus import usual_tv_weight

    return usual_tv_weight(noise_variance, 1 if picture.ndim == 2 else 3, found.intensities)


def _weight_line(facts: Mapping[str, Any]) -> str:
    return f"tv weight    {facts['tv_weight']:.2g}"


def _restored_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield from lines_of(facts)
    yield _weight_line(facts)
    yield from last_lines(facts)


def _refocused_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield from lines_of(facts)
    yield _weight_line(facts)
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
