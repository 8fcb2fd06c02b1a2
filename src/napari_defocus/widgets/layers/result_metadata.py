"""Results in a viewer: how they say what made them, and how they are found.

No Qt here, as in `layers`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from napari.components import LayerList
from napari.layers import Image, Layer
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.likelihood.psf_choice import PSFChoice
from napari_defocus.psf import BLUR_RADIUS
from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.layers.image_layers import Plane

METADATA_KEY = "napari_defocus"
"""Where a result layer's metadata say how it was made."""

RUN = "run"
"""Which run has made a result, in its metadata: the larger the number, the newer."""

BLUR_MAP = "blur map"
DEFOCUS = "defocus"
CONFIDENCE = "confidence"
NOT_TRUSTED = "not trusted"
IN_FOCUS = "in focus"
MEASURED_PSF = "measured PSF"
ALL_IN_FOCUS = "all in focus"
LEFT_AS_IT_WAS = "left as it was"
REFOCUSED = "refocused"
DEPTH = "depth"
DEPTH_SURFACE = "depth surface"
RELIEF = "relief"
SHARPEST = "sharpest pixels"
BEST_FOCUS = "best focus"
HEIGHT = "height"
FOCUS_CONFIDENCE = "best focus confidence"

OUTSIDE = (
    "outside of the shapes nothing is in focus and the confidence is 0; the map there is an "
    "estimate like any other"
)
"""What holds for the pixels of a part that do not count."""

PLANES = "planes"
"""Where a stack's metadata say which of its axes are its planes', and what each one had."""

STORE = "store"
"""Where the metadata of a result that is kept on the disk say in which folder, and how long."""

ALIGNMENT = "alignment"
"""Where the metadata of a stack's sharpest pixels say how its planes lie on each other."""

REGION = "region"
"""Where the metadata of a result say which part of a plane it is of, see `region_description`."""

AT = "at"
"""Where the metadata of a result say which plane of a stack it is of: a number an axis, or None."""

THRESHOLD_FOUND = "threshold found"
"""Whether the threshold of a mask, in px among its settings, was found from the picture."""

PLACEMENT = ("scale", "translate", "rotate", "shear", "affine", "units", "axis_labels")
"""The keywords that say where a layer lies."""


@dataclass(frozen=True, eq=False)
class Results:
    """What a run returns.

    Attributes
    ----------
    layers : list of LayerDataTuple
        See `add_results`.
    summary : str
        What to say about them, in a few lines.
    """

    layers: list[LayerDataTuple]
    summary: str

    def with_lens(self, choice: PSFChoice) -> Results:
        """Return them, saying how the lens of all planes was chosen."""
        return Results(say_lens(self.layers, choice), f"Lens: {choice}\n{self.summary}")

    def with_threshold(self, threshold: float) -> Results:
        """Return them, saying which threshold of masks was found from all planes."""
        for _, keywords, _ in self.layers:
            made = keywords["metadata"][METADATA_KEY]
            if made["result"] == IN_FOCUS:
                made[THRESHOLD_FOUND] = True
        said = f"In focus up to {threshold:.4g} px (found from the planes)"
        return Results(self.layers, f"{self.summary}\n{said}")


def provenance(plane: Plane, result: str, settings: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return the metadata of a result: what it is, of which plane, what made it, and more."""
    made = {
        "version": __version__,
        "result": result,
        "source": plane.name,
        "settings": settings,
        AT: [at if isinstance(at, int) else None for at in plane.index],
    }
    if plane.is_part or plane.region:
        made[REGION] = region_description(plane)
    return {METADATA_KEY: made | more}


def result_layer(
    plane: Plane,
    result: str,
    values: NDArray[Any],
    settings: dict[str, Any],
    more: dict[str, Any],
    *,
    name: str = "",
    kind: str = "image",
    **looks: Any,
) -> LayerDataTuple:
    """Return a result as a layer that lies on the plane that it was made from.

    Parameters
    ----------
    plane, result, settings, more
        See `provenance`.
    values : (H, W) or (H, W, 3) ndarray
    name : str, optional
        What stands behind the plane's name; by default the result's.
    kind : {"image", "labels"}, optional
    **looks
        Keywords of the layer.
    """
    keywords = {
        "name": f"{plane.name}{region_suffix(plane.region)} {name or result}",
        "metadata": provenance(plane, result, settings, **more),
        **looks,
        **plane.placement,
    }
    return LayerDataTuple((plane.expanded(values), keywords, kind))


def region_suffix(region: str) -> str:
    """Return what stands behind a picture's name in those of results of a part of it.

    Examples
    --------
    >>> region_suffix("shapes “Flower”"), region_suffix("visible field"), region_suffix("")
    (' (Flower)', ' (visible field)', '')
    """
    return f" ({region.removeprefix('shapes “').removesuffix('”')})" if region else ""


def region_of_result(layer: Layer) -> str:
    """Return what chose the part of the picture that a result is of; "" for the whole plane."""
    description = layer.metadata[METADATA_KEY].get(REGION) or {}
    return str(description.get("of", ""))


def noise_description(
    given: float | None, variances: Collection[float], growth: float = 0.0
) -> str:
    """Return a line that says the noise variance of planes, and whether the user has given it.

    `growth` is by how much it is larger in the corners than in the centre.

    Examples
    --------
    >>> noise_description(None, [1e-6, 2.5e-5]), noise_description(1e-6, [1e-6])
    ('Noise variance 1.0e-06 to 2.5e-05 (found)', 'Noise variance 1.0e-06 (given)')
    >>> noise_description(None, [3e-5], 1.3)
    'Noise variance 3.0e-05 (found), 2.3 times that in the corners'
    """
    low, high = float(min(variances)), float(max(variances))
    span = f"{low:.1e}" if low == high else f"{low:.1e} to {high:.1e}"
    said = f"Noise variance {span} ({'found' if given is None else 'given'})"
    return f"{said}, {1 + growth:.1f} times that in the corners" if growth else said


def say_lens(layers: list[LayerDataTuple], choice: PSFChoice | None) -> list[LayerDataTuple]:
    """Let the metadata of new layers say how the lens was chosen, if the picture was to choose."""
    if choice is not None:
        for _, keywords, _ in layers:
            keywords["metadata"][METADATA_KEY]["lens"] = f"Lens: {choice}"
    return layers


def say_doubt(layers: list[LayerDataTuple], doubt: str | None) -> list[LayerDataTuple]:
    """Let the metadata of new layers say why the picture does not look like defocus, if so."""
    if doubt is not None:
        for _, keywords, _ in layers:
            keywords["metadata"][METADATA_KEY]["doubt"] = doubt
    return layers


def say_noise_growth(layers: list[LayerDataTuple], growth: float) -> list[LayerDataTuple]:
    """Let the metadata of new layers say by how much noise is larger in the corners, if it is."""
    if growth:
        for _, keywords, _ in layers:
            keywords["metadata"][METADATA_KEY]["noise_growth"] = growth
    return layers


def scale_prefix(scale_name: str) -> str:
    """Return what a map measures, to be put before "(px)"; nothing if blur radii, as usual."""
    return "" if scale_name == BLUR_RADIUS else scale_name.removesuffix("(px)")


def confidence_description(share: float) -> str:
    """Return a line that says on what share of the pixels the confidence is high."""
    return f"Trusted on {share:.0%} (confidence {CONFIDENT:g} or more)"


def region_description(plane: Plane) -> dict[str, Any]:
    """Return what metadata say about a part of a plane.

    Returns
    -------
    dict
        What chose it, where its rows and columns start and stop in px of the whole plane, and
        what holds for the pixels that do not count.
    """
    rows, columns = (
        list(cut.indices(length)[:2])
        for cut, length in zip(plane.cuts, plane.whole_shape, strict=True)
    )
    description: dict[str, Any] = {"of": plane.region, "rows": rows, "columns": columns}
    if plane.inside is not None:
        description["outside"] = OUTSIDE
    return description


def made_by_us(layer: Layer) -> str | None:
    """Return what result a layer holds, None if it is no result of ours."""
    made = layer.metadata.get(METADATA_KEY, {})
    return made.get("result") if isinstance(made, dict) else None


def pictures_in(layers: Iterable[Layer]) -> list[Image]:
    """Return the image layers that are no results of ours."""
    return [layer for layer in layers if isinstance(layer, Image) and made_by_us(layer) is None]


def results_of(layers: LayerList, result: str, source: str) -> list[Layer]:
    """Return the layers that hold a result of the layer named `source`, the newest first."""
    found = [
        layer
        for layer in layers
        if made_by_us(layer) == result and layer.metadata[METADATA_KEY].get("source") == source
    ]
    return newest_first(found)


def layer_of_result(
    layers: LayerList, result: str, source: str, region: str | None = None
) -> Layer | None:
    """Return the newest layer that holds a result of the layer named `source`, if there is one.

    With a `region`, only what is of that part of the picture, see `region_of_result`.
    """
    found = results_of(layers, result, source)
    return next(
        (layer for layer in found if region is None or region_of_result(layer) == region), None
    )


def same_estimation(layer: Layer, other: Layer) -> bool:
    """Tell whether two results of ours say that the same settings and noise have made them."""
    description, others = (found.metadata[METADATA_KEY] for found in (layer, other))
    return all(description.get(key) == others.get(key) for key in ("settings", "noise_variance"))


def run_of(layer: Layer) -> int:
    """Return the number of the call of `add_results` that has shown a result last: 1, 2, ...

    It is 0 if the layer does not say it.
    """
    made = layer.metadata.get(METADATA_KEY)
    run = made.get(RUN, 0) if isinstance(made, dict) else 0
    return run if isinstance(run, int) else 0


def newest_first(layers: list[Layer]) -> list[Layer]:
    """Return layers of results, those of the latest run first."""
    # A duplicate stands behind what it was made from: of the same run, the first counts.
    return sorted(layers, key=run_of, reverse=True)
