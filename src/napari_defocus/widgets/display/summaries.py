"""What there is to say about a map and a mask that were made: no Qt."""

from typing import Any

import numpy as np
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.picture_remarks import picture_remarks
from napari_defocus.settings import CONFIDENT, MapSettings
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.layers.result_metadata import (
    DEFOCUS,
    METADATA_KEY,
    REGION,
    confidence_description,
    noise_description,
)


def summary_of(
    results: list[LayerDataTuple], confidence: NDArray[np.floating] | None, picture: Picture
) -> str:
    """Return a few lines: what makes the map say little, of which part it is, how sure it is."""
    made = results[-1][1]["metadata"][METADATA_KEY]
    lines = picture_remarks(picture.image, MapSettings.window)
    # What is seen in the picture explains the doubt, too.
    said = ("lens",) if lines else ("doubt", "lens")
    lines += [made[name] for name in said if name in made]
    lines += [_defocus_line(layer) for layer in results if _result(layer) == DEFOCUS]
    if REGION in made:
        lines.append(f"Measured: {made[REGION]['of']}")
    lines.append(noise_description(made["settings"]["noise_variance"], [made["noise_variance"]]))
    share = None if confidence is None else (confidence >= CONFIDENT).mean()
    if share == 0:
        lines.append("Nothing can be known here: it has no texture that tells of blur.")
    elif share is not None:
        lines.append(confidence_description(share))
    return "\n".join(lines)


def _result(layer: LayerDataTuple) -> Any:
    return layer[1]["metadata"][METADATA_KEY]["result"]


def _defocus_line(layer: LayerDataTuple) -> str:
    """Return the defocus of a picture in a line, and what one picture cannot tell of it."""
    low, median, high = np.nanpercentile(layer[0], [5, 50, 95])
    side = layer[1]["metadata"][METADATA_KEY]["side"]
    return f"Defocus {median:.3g} µm (5 to 95 %: {low:.3g} to {high:.3g} µm), {side}"
