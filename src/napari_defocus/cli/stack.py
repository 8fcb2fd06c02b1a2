"""The terminal command for a stack through focus: which plane is sharp where, and one picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import napari_defocus
from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import intensity_facts, intensity_lines
from napari_defocus.cli.results import beside, check_endings
from napari_defocus.core.checks import Linearize
from napari_defocus.core.progress import Progress, within
from napari_defocus.io.provenance import SHARPEST_PIXELS
from napari_defocus.psf import AUTO
from napari_defocus.settings import CONFIDENT, MapSettings

if TYPE_CHECKING:
    from napari_defocus.io.open import Source
    from napari_defocus.stacks.focus_stacking import SharpestPlane
    from napari_defocus.stacks.matched_planes import Align

Choice = Literal["auto", "yes", "no"]

_PLANES_TOLD = 5
_CHOICES: dict[Choice, Literal["auto"] | bool] = {"auto": "auto", "yes": True, "no": False}


def _lines(facts: Facts) -> Iterator[str]:
    size = f"{facts['width']} x {facts['height']} px"
    yield f"stack        {facts['image']}, {facts['planes']} planes of {size}"
    if facts["pictures"]:
        yield f"pictures     from {facts['pictures'][0]} to {facts['pictures'][-1]}"
    for name in ("scene", "channel", "time"):
        if facts[name] is not None:
            called = facts["channel_name"] if name == "channel" else ""
            yield f"{name:<12} {facts[name]} (from 0)" + (f", {called}" if called else "")
    if facts["focus_note"]:
        yield f"focus        {facts['focus_note']}"
    yield from intensity_lines(facts)
    for note in facts["notes"]:
        yield f"planes       {note}"
    if facts["px_per_plane"] is None:
        yield "blur         not found: too little texture to see it grow from plane to plane"
    else:
        yield f"blur         grows by {facts['px_per_plane']:.2f} px from plane to plane"
    yield _sharpest_planes(facts["share_of_plane"], facts["pictures"])
    yield from _height_lines(facts)
    yield (
        f"confidence   {CONFIDENT:g} or more on {facts['confident_percent']:.1f} % of the picture"
    )
    yield from last_lines(facts)


def _sharpest_planes(shares: Sequence[float], names: Sequence[str] | None) -> str:
    """Say which plane is the sharpest on most pixels, by its picture's name too, and the next."""
    order = sorted(range(len(shares)), key=lambda plane: -shares[plane])
    best, *others = (f"{plane} ({shares[plane]:.0%})" for plane in order[:_PLANES_TOLD])
    if names:
        best = f"{best}, {names[order[0]]}"
    return f"sharpest     on most pixels: plane {best}; then {', '.join(others)} (counted from 0)"


@command(
    _lines,
    """
    stack STACK...
        Planes of one scene at equal steps of the focus: a TIFF stack (also OME-TIFF, .lsm, .stk),
        OME-Zarr, CZI, ND2 and LIF with the extra microscopes, a folder of pictures, or several
        pictures. Pictures are planes in the natural order of their names: slice2 comes before
        slice10, and z-0.7um before z+0.1um.
    scene NUMBER
        Which scene of a CZI, ND2 or LIF file to take, from 0; needed if STACK has several.
    channel NUMBER
        Which channel to take, from 0; needed if STACK has several. Channels are never taken for
        planes.
    time NUMBER
        Which time to take, from 0; needed if STACK has several beside its planes.
    output -o PATH
        Where to write the picture of the sharpest pixels (.tif, or .png if STACK has 8 or 16 bit).
        [default: STACK-sharpest.tif, beside STACK]
    position PATH
        Where to write the position of best focus of every pixel (.tif): planes from 0, and parts of
        planes.
    height PATH
        Where to write the height of best focus above the first plane, in um (.tif).
    z_step UM
        How far planes are apart, in um; negative if they go down. It is read from STACK if left
        out.
    confidence PATH
        Where to write how sure the positions are (.tif): the probability that each is right to half
        a plane.
    px_per_plane PX
        By how many px the radius of the blur grows from plane to plane. It is found from the stack
        if left out.
    align
        Whether planes that drift, turn or are magnified are laid on the middle one first: auto (if
        motion is surely there), yes (always) or no (never).
    use_alignment FILE
        Use the alignment that --save-alignment wrote for this stack or another channel.
    save_alignment FILE
        Where to write how the planes were laid on the middle one (.json).
    match_brightness
        Whether planes that a lamp made brighter or darker are made equally bright: auto (if they
        surely differ), yes or no.
    composite
        blended mixes the planes about each position, which averages noise and has no seams; pixels
        takes the pixels of the nearest plane.
    peak
        Which plane to take where two are sharp, as in something transparent: the strongest, the
        first or the last.
    all_channels PATH
        Where to write a picture of every channel (.tif), put together at the positions that were
        found in --channel.
    """,
)
def sharpest(
    stack: list[Path],
    *,
    scene: int | None = None,
    channel: int | None = None,
    time: int | None = None,
    px_per_plane: float | None = None,
    align: Choice = "auto",
    use_alignment: Path | None = None,
    save_alignment: Path | None = None,
    match_brightness: Choice = "auto",
    composite: Literal["blended", "pixels"] = "blended",
    peak: Literal["strongest", "first", "last"] = "strongest",
    psf: str = MapSettings.psf,
    noise_variance: float | None = MapSettings.noise_variance,
    max_radius: float = MapSettings.max_radius,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    output: Path | None = None,
    position: Path | None = None,
    height: Path | None = None,
    z_step: float | None = None,
    confidence: Path | None = None,
    all_channels: Path | None = None,
    force: bool = False,
    progress: Progress,
) -> dict[str, Any]:
    """Find where STACK is in focus, and make one sharp picture.

    Each pixel has a plane in which it is the sharpest.
    """
    from napari_defocus.core.axes import focus_axis
    from napari_defocus.core.writing import check_results
    from napari_defocus.io.open import open_stack

    shaping: dict[str, Any] = {
        "noise_variance": noise_variance,
        "smoothness": smoothness,
        "color_sigma": color_sigma,
        "linearize": linearize,
    }
    family = MapSettings(psf=psf, max_radius=max_radius, **shaping).family()
    if psf == AUTO:
        raise ValueError("psf is 'auto', which works for maps only; it takes a lens such as disc")
    pictures = (position, height, confidence, all_channels)
    check_endings([path for path in pictures if path], ".tif", ".tiff")
    check_endings([output] if output else [], ".tif", ".tiff", ".png")
    if save_alignment is not None:
        check_endings([save_alignment], ".json")
    given = _given_alignment(use_alignment, align)
    source = open_stack(stack, scene)
    dtype = source.data.dtype
    if output is not None and _is_png(output) and (dtype.kind != "u" or dtype.itemsize > 2):
        raise ValueError(
            f"output is {output}, but {source.path} holds {dtype}; PNG takes 8 or 16 bit, .tif any"
        )
    if all_channels is not None and "c" not in source.axes:
        raise ValueError(f"--all-channels: {source.path} has no channels")
    wanted = (output or _usual_output(source), position, confidence, height)
    outputs = [path for path in (*wanted, all_channels, save_alignment) if path]
    focus = focus_axis(
        source.data.shape,
        source.axes,
        channel=channel,
        time=time,
        name=str(source.path),
        said=lambda argument: f"--{argument}",
    )
    step = _z_step_um(source, focus.letter) if z_step is None else z_step
    _check_step(step, height, source)
    for path in source.files:
        check_results(outputs, force=force, source=path)
    found = napari_defocus.sharpest_plane(
        source.data,
        axes=source.axes,
        channel=channel,
        time=time,
        px_per_plane=px_per_plane,
        align=given,
        match_brightness=_CHOICES[match_brightness],
        blend=composite == "blended",
        peak=peak,
        psf=family,
        intensity_range=intensity_range,
        progress=within(progress, 0.0, 0.7 if all_channels else 1.0),
        **shaping,
    )
    facts = _facts(source, found, outputs) | {"scene": scene, "channel": channel, "time": time}
    facts["channel_name"] = source.channel_names[channel or 0] if source.channel_names else ""
    facts |= {"focus_axis": focus.letter, "focus_note": focus.note}
    facts |= _height_facts(found, step)
    told = facts | {"psf": psf, "smoothness": smoothness}
    names = ("image", "scene", "channel", "time", "psf", "smoothness", "px_per_plane")
    _write(wanted, source, found, {name: told[name] for name in names}, force, step)
    if all_channels is not None:
        at = {"time": time, "blend": composite == "blended", "psf": family}
        _write_channels(all_channels, source, found, at, force, within(progress, 0.7, 1.0))
    if save_alignment is not None:
        laid = found.alignment or napari_defocus.StackAlignment.still(
            (facts["height"], facts["width"]), facts["planes"]
        )
        laid.save(save_alignment, force=force)
    return facts


def _is_png(path: Path) -> bool:
    return path.suffix.lower() == ".png"


def _z_step_um(source: Source, axis: str) -> float | None:
    """Return how far the planes of a stack are apart in um, if it notes that."""
    from napari_defocus.io.tiff_pixel_size import MICROMETERS

    unit = MICROMETERS.get(source.units.get(axis, ""))
    return None if unit is None or axis not in source.pixel_size else source.pixel_size[axis] * unit


def _check_step(step: float | None, height: Path | None, source: Source) -> None:
    """Refuse heights without a step before any long work."""
    import math

    if step is None and height is not None:
        raise ValueError(
            f"height is {height}, but {source.path} does not note how far its planes are apart; "
            "give --z-step in um"
        )
    if step is not None and not 0 < abs(step) < math.inf:
        raise ValueError(f"z_step is {step}; it takes a finite number of um, not 0")


def _height_facts(found: SharpestPlane, step: float | None) -> dict[str, Any]:
    """Return what is told of heights, in um above the first plane; None if no step is known."""
    import numpy as np

    if step is None:
        return {"z_step_um": None}
    low, median, high = np.percentile(found.height_um(step), [5, 50, 95])
    heights = {"height_p5_um": low, "height_median_um": median, "height_p95_um": high}
    return {"z_step_um": step} | {name: float(value) for name, value in heights.items()}


def _height_lines(facts: Facts) -> Iterator[str]:
    if facts["z_step_um"] is not None:
        low, median, high = (facts[f"height_{name}_um"] for name in ("p5", "median", "p95"))
        yield (
            f"height       median {median:.4g} um above plane 0, 5 to 95 % of the picture: "
            f"{low:.4g} to {high:.4g} um; planes {facts['z_step_um']:.4g} um apart"
        )


def _given_alignment(path: Path | None, align: Choice) -> Align:
    """Return the alignment of a file, or the choice."""
    if path is None:
        return _CHOICES[align]
    if align != "auto":
        raise ValueError(f"--align {align} and --use-alignment are both given; it takes one")
    return napari_defocus.StackAlignment.load(path)


def _write_channels(
    path: Path,
    source: Source,
    found: SharpestPlane,
    at: dict[str, Any],
    force: bool,
    progress: Progress,
) -> None:
    """Write what `composite_at` makes of each channel."""
    import numpy as np

    count = source.data.shape[source.axes.index("c")]
    rate = found.px_per_plane if np.isfinite(found.px_per_plane) else 1.0
    pictures = [
        napari_defocus.composite_at(
            found.position,
            source.data,
            axes=source.axes,
            channel=number,
            alignment=found.alignment,
            px_per_plane=rate,
            progress=within(progress, number / count, (number + 1) / count),
            **at,
        )
        for number in range(count)
    ]
    _write_picture(path, np.stack(pictures), "cyx", SHARPEST_PIXELS, "", source, {}, force)


def _usual_output(source: Source) -> Path:
    """Return where the picture goes: beside a stack, a folder of pictures, or their first."""
    if source.path in source.files:
        return beside(source.path, "-sharpest.tif")[0]
    folder = source.path if source.path.name not in ("", "..") else source.path.resolve()
    return folder.with_name(f"{folder.name}-sharpest.tif")


def _write(
    outputs: tuple[Path | None, ...],
    source: Source,
    found: SharpestPlane,
    made_with: dict[str, Any],
    force: bool,
    step: float | None,
) -> None:
    colors = "s" if source.axes.endswith("s") else ""
    results = (
        (found.composite, f"yx{colors}", SHARPEST_PIXELS, ""),
        (found.position, "yx", "position of best focus", "planes"),
        (found.confidence, "yx", "confidence of the position", ""),
        (None if step is None else found.height_um(step), "yx", "height of best focus", "um"),
    )
    for path, (values, axes, quantity, unit) in zip(outputs, results, strict=True):
        if path is not None:
            _write_picture(path, values, axes, quantity, unit, source, made_with, force)


def _write_picture(
    path: Path,
    values: Any,
    axes: str,
    quantity: str,
    unit: str,
    source: Source,
    made_with: dict[str, Any],
    force: bool,
) -> None:
    from napari_defocus.core.writing import write_results
    from napari_defocus.io.encoders import lossless_png
    from napari_defocus.io.tiff_writer import write_pyramidal_tiff

    if _is_png(path):
        write_results({path: lossless_png(values, quantity)}, force=force)
        return
    write_pyramidal_tiff(
        path,
        values,
        axes=axes,
        pixel_size={axis: size for axis, size in source.pixel_size.items() if axis in "yx"},
        units={axis: unit for axis, unit in source.units.items() if axis in "yx"},
        description={"quantity": quantity, "unit": unit, "settings": made_with},
        force=force,
    )


def _facts(source: Source, found: SharpestPlane, outputs: list[Path]) -> dict[str, Any]:
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
        "notes": list(found.notes),
        "gain": found.gain.tolist(),
        "largest_motion_px": found.alignment.largest_motion if found.alignment else 0.0,
        "two_peaks_percent": 100.0 * float(found.two_peaks.mean()),
        "files": [str(path) for path in outputs],
    }
