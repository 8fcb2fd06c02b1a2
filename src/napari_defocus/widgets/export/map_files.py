"""Blur maps and their confidence as files: TIFFs that become the same layers again.

No Qt here, as in `layers`. napari asks the user which plugin shall read a file if the patterns of
two match its name, and its own reader takes every .tif: hence the names of `PATTERNS`, so that
other TIFFs open as ever.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Layer

from napari_defocus.core.color_range import color_limit
from napari_defocus.core.writing import NeedsForce, UnwritableResult, write_results
from napari_defocus.io.encoders import (
    blur_map_tiff,
    check_unit,
    confidence_tiff,
    description_in_tiff,
    holds,
    values_in_tiff,
)
from napari_defocus.psf import BLUR_RADIUS
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import show_color_bar
from napari_defocus.widgets.export.stores import NotAMapError, copy_store, is_stored
from napari_defocus.widgets.layers.result_layers import COLOR_MAP, CONFIDENCE_COLOR_MAP
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    METADATA_KEY,
    PLACEMENT,
    scale_prefix,
)

PATTERNS = (
    "*-blur.tif",
    "*-blur.tiff",
    "* blur *(px).tif",
    "* blur *(px).tiff",
    "*-confidence.tif",
    "*-confidence.tiff",
    "* confidence.tif",
    "* confidence.tiff",
)
"""What the manifest's reader takes; the files that we name have such names."""

TIFF_ENDINGS = (".tif", ".tiff")
ENDING_OF = {BLUR_MAP: "-blur.tif", CONFIDENCE: "-confidence.tif"}

LayerTuple = tuple[Any, dict[str, Any], str]


def save_map(layer: Image, path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Save a blur map, or its confidence, as a TIFF that says what it is and what made it.

    `open_map` makes the same layer of it: values bit for bit, place, units and metadata. So does
    napari itself if the name fits `PATTERNS`. The terminal command reads one with ``--map``.

    Parameters
    ----------
    layer : napari.layers.Image
        One of ours: a map of one plane, or of a stack. If it is kept on the disk, as those of
        large pictures are, its OME-Zarr store is copied, and no part of it is read.
    path : path-like
        A name without .tif or .tiff gets an ending; of what is on the disk, one without .zarr.
    force : bool, optional
        Whether a file that exists is overwritten.

    Returns
    -------
    Path
        The file that was written, whole or not at all.

    Raises
    ------
    NotAMapError
        If the layer is another one.
    OSError
        If the file cannot be written, or exists and `force` is not set.
    """
    data = layer.as_layer_data_tuple()
    if is_stored(data):
        return copy_store(data, Path(path), force=force)
    target = _named(Path(path), _result_of(data))
    write_results({target: _encoded(data)}, force=force)
    return target


def write_maps(path: str, layers: Sequence[LayerTuple]) -> list[str]:
    """Save a blur map or its confidence as `save_map`, for the manifest, and return its path.

    It is the only layer, and its file may get an ending. napari's dialog has asked before it
    overwrites the file.
    """
    if len(layers) != 1:
        raise NotAMapError("A blur map is saved on its own. Choose its layer only.")
    [layer] = layers
    if is_stored(layer):
        return [str(copy_store(layer, Path(path)))]
    target = _named(Path(path), _result_of(layer))
    # The dialog knows nothing of an ending that the name gets here.
    try:
        write_results({target: _encoded(layer)}, force=target == Path(path))
    except NeedsForce as error:
        raise UnwritableResult(saving_failure(error)) from None
    return [str(target)]


def saving_failure(error: Exception) -> str:
    """Return why something chosen in a dialog could not be saved, for those who see the dialog."""
    if isinstance(error, NeedsForce):
        return error.told("choosing its full name in the dialog")
    return str(error)


def map_reader(path: str | list[str]) -> Callable[[str | list[str]], list[Image]] | None:
    """Return what reads files of `save_map` or of the terminal; None if one is another file."""
    ours = all(holds(description_in_tiff(file)) for file in _listed(path))
    return read_maps if ours else None


def read_maps(path: str | list[str]) -> list[Image]:
    """Return the layers that files of `save_map` or of the terminal hold, see `read_map`."""
    return [read_map(file) for file in _listed(path)]


def read_map(path: str | os.PathLike[str]) -> Image:
    """Return the layer that a file of `save_map` or of the terminal holds.

    Returns
    -------
    napari.layers.Image
        With a colour bar, from 0 to the largest scale that was looked for, and metadata by which
        the widgets know it.

    Raises
    ------
    NotAMapError
        If it is another file.
    ValueError
        If it is cut off or damaged, or from before all lenses had one unit.
    """
    description = description_in_tiff(path)
    result = holds(description)
    if result is None:
        raise NotAMapError(
            f"“{Path(path).name}” is no blur map of this plugin or its terminal command. "
            "Open it as a picture instead."
        )
    check_unit(description, path)
    made = _made(description, result, Path(path))
    values = values_in_tiff(path)
    largest = description.get("max_scale") or color_limit(values)
    placed = description.get("layer", {})
    layer = Image(
        values,
        name=placed.get("name") or _usual_name(made, result),
        colormap=COLOR_MAP if result == BLUR_MAP else CONFIDENCE_COLOR_MAP,
        contrast_limits=(0.0, largest if result == BLUR_MAP else 1.0),
        metadata={METADATA_KEY: made},
        **{key: placed[key] for key in PLACEMENT if key in placed},
    )
    show_color_bar(layer)
    return layer


def open_map(viewer: ViewerModel, path: str | os.PathLike[str]) -> Layer:
    """Add the layer of `read_map` to a viewer, whatever the file's name, and return it."""
    return viewer.add_layer(read_map(path))


def _listed(path: str | list[str]) -> list[str]:
    return [path] if isinstance(path, str) else list(path)


def _result_of(layer: LayerTuple) -> str:
    made = layer[1].get("metadata", {}).get(METADATA_KEY)
    result = made.get("result") if isinstance(made, dict) else None
    if result not in ENDING_OF:
        raise NotAMapError(
            f"“{layer[1].get('name')}” is no blur map or confidence of this plugin. "
            "Save it with another file type."
        )
    return str(result)


def _named(path: Path, result: str) -> Path:
    """Return a path with an ending that says what it is."""
    if path.suffix.lower() in TIFF_ENDINGS:
        return path
    whole = path.with_name(f"{path.name}.tif")
    fits = any(fnmatch(whole.name, pattern) for pattern in PATTERNS)
    return whole if fits else path.with_name(path.name + ENDING_OF[result])


def _encoded(layer: LayerTuple) -> bytes:
    data, keywords, _ = layer
    made = dict(keywords["metadata"][METADATA_KEY])
    # The file says more than the layer, such as the version of this package.
    placed = _placed(keywords) | {"metadata": list(made)}
    settings = made.pop("settings", None) or {}
    values = np.asarray(data[0] if keywords.get("multiscale") else data)
    more = made | {"layer": placed}
    size = _pixel_size(keywords)
    if made["result"] == CONFIDENCE:
        return confidence_tiff(values, settings, made=more, pixel_size=size)
    more["max_scale"] = float(max(keywords["contrast_limits"]))
    scale = {"scale_name": made["scale"]} if "scale" in made else {}
    return blur_map_tiff(values, settings, **scale, made=more, pixel_size=size)


def _placed(keywords: dict[str, Any]) -> dict[str, Any]:
    placed = {key: np.asarray(keywords[key]).tolist() for key in PLACEMENT if key in keywords}
    if "units" in placed:
        placed["units"] = [str(unit) for unit in keywords["units"]]
    return {"name": keywords["name"], **placed}


def _pixel_size(keywords: dict[str, Any]) -> tuple[float, float] | None:
    """Return the height and width of a pixel in m, None if its units are no lengths."""
    units = keywords["units"][-2:]
    if not all(unit.is_compatible_with("meter") for unit in units):
        return None
    scale = np.asarray(keywords["scale"], float)[-2:]
    height, width = (
        float((side * unit).to("meter").magnitude) for side, unit in zip(scale, units, strict=True)
    )
    return height, width


def _made(description: dict[str, Any], result: str, path: Path) -> dict[str, Any]:
    """Return the metadata of a layer."""
    if "layer" in description:
        return {key: description[key] for key in description["layer"]["metadata"]}
    # The terminal wrote it: its settings say the variance that was found, and a little more.
    known = dict(description.get("settings", {}))
    settings = {each.name: known[each.name] for each in fields(MapSettings) if each.name in known}
    if settings.get("shot_noise"):
        settings["noise_variance"] = None
    made = {
        "version": description.get("version"),
        "result": result,
        "source": path.stem.removesuffix("-blur").removesuffix("-confidence"),
        "settings": settings,
        "noise_variance": known.get("noise_variance"),
    }
    made |= {"scale": description["scale"]} if "scale" in description else {}
    return made | {key: known[key] for key in ("min_confidence",) if key in known}


def _usual_name(made: dict[str, Any], result: str) -> str:
    """Return what `result_layers` calls such a layer."""
    if result == CONFIDENCE:
        return f"{made['source']} {CONFIDENCE}"
    return f"{made['source']} blur {scale_prefix(made.get('scale', BLUR_RADIUS))}(px)"
