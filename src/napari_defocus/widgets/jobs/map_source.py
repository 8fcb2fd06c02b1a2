"""Where the blur map comes from that something is made of: estimated, or a layer's.

No Qt, any thread.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.progress import Progress
from napari_defocus.psf import AUTO
from napari_defocus.psf.parsing import psf_of
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.jobs.estimation import (
    LARGEST_RADIUS,
    EstimatedMap,
    JobCache,
    Picture,
    estimated_map,
    known_map,
)
from napari_defocus.widgets.layers.alignment import lies_on, same_part
from napari_defocus.widgets.layers.image_layers import (
    NotAnalysableError,
    Plane,
    finest,
    shown_plane,
)
from napari_defocus.widgets.layers.result_layers import blur_map_layer, confidence_layer
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    METADATA_KEY,
    made_by_us,
    results_of,
    run_of,
    same_estimation,
    say_doubt,
    say_lens,
    say_noise_growth,
)

if TYPE_CHECKING:
    from napari_defocus import PSFFamily

Float32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class BlurMap:
    """A blur map as the work after it needs it.

    Attributes
    ----------
    name : str
        Of its layer.
    values : (H, W) float32 ndarray
        Scale in px, from 0 up; NaN is unknown.
    psf : PSFFamily
        Whose scale it is; its domain reaches as far as the values.
    confidence : (H, W) float32 ndarray or None
        In [0, 1]; None if it is not known.
    safe : (H, W) float32 ndarray or None
        How much of it is safe to take away, in px; None if it is not known.
    layers : list of LayerDataTuple
        To be shown: the map and its confidence, if they were estimated.
    """

    name: str
    values: Float32
    psf: PSFFamily
    confidence: Float32 | None
    safe: Float32 | None = None
    layers: list[LayerDataTuple] = field(default_factory=list)

    def checked_for_restoration(self) -> Float32:
        """Return the values, all of which are finite and not beyond what is restored.

        Raises
        ------
        ValueError
            If they are not.
        """
        if not np.isfinite(self.values).all():
            raise ValueError(
                f"its blur map “{self.name}” has pixels without a value (NaN). Fill them first."
            )
        radius = float(self.values.max())
        if radius > LARGEST_RADIUS:
            raise ValueError(
                f"its blur map “{self.name}” goes up to a radius of {radius:.4g} px; up to "
                f"{LARGEST_RADIUS:g} px can be taken away. Is it a blur map?"
            )
        return self.values


class MapSource(Protocol):
    """Where a blur map comes from."""

    def read(self, picture: Picture, cache: JobCache, progress: Progress) -> BlurMap:
        """Return the blur map of a picture."""

    def described(self, psf: PSFFamily) -> dict[str, Any]:
        """Return what metadata say about it; `psf` is that of the map that it gave."""


@dataclass(frozen=True, kw_only=True)
class EstimatedSource:
    """A map that is estimated from the picture."""

    settings: MapSettings

    def __post_init__(self) -> None:
        """Refuse impossible settings before any work is done with them."""
        self.settings.family()

    def read(self, picture: Picture, cache: JobCache, progress: Progress) -> BlurMap:
        """Return the blur map of a picture, that of an earlier run if nothing has changed."""
        found = estimated_map(picture, self.settings, cache, progress)
        layers = layers_of_map(picture.plane, self.settings, found)
        # What was asked for is not the map: its colour bar would stand before the result.
        layers[0][1]["visible"] = False
        return BlurMap(
            name=layers[0][1]["name"],
            values=found.values,
            psf=found.psf,
            confidence=picture.plane.counted(found.confidence),
            safe=found.safe,
            layers=layers,
        )

    def described(self, psf: PSFFamily) -> dict[str, Any]:
        """Return what metadata say about it; `psf` is that of the map that it gave."""
        return asdict(self.settings.settled(psf))


def layers_of_map(plane: Plane, settings: MapSettings, found: EstimatedMap) -> list[LayerDataTuple]:
    """Return the layers of a map and of its confidence.

    They hold copies: what somebody paints on a layer is not cached.
    """
    made_with = settings.settled(found.psf), found.noise_variance
    sure, intensities = plane.counted(found.confidence), found.intensities
    layers = [
        blur_map_layer(plane, found.values.copy(), *made_with, found.psf, intensities),
        confidence_layer(plane, sure, *made_with, intensities),
    ]
    say_noise_growth(layers, found.noise_growth)
    return say_doubt(say_lens(layers, found.psf_choice), found.doubt)


@dataclass(frozen=True, kw_only=True)
class LayerSource:
    """A map that a layer holds.

    Attributes
    ----------
    plane : Plane
        The map.
    psf : str
        The family whose scale it is, as `napari_defocus.psf_from_text` reads it.
    max_radius : float
        Largest radius that was looked for, in px.
    confidence : Plane or None
    made_with : MapSettings or None
        What it was estimated with, if we did and nothing has changed it.
    """

    plane: Plane
    psf: str
    max_radius: float = MapSettings.max_radius
    confidence: Plane | None = None
    made_with: MapSettings | None = None

    def __post_init__(self) -> None:
        """Refuse a lens that cannot be before any work is done with it."""
        psf_of(self.psf, self.max_radius)
        if self.psf == AUTO:
            raise ValueError(
                f"“{self.plane.name}” does not say with which lens it was measured. Choose the "
                "lens: only a map that is estimated finds it from the picture."
            )

    def read(self, picture: Picture, cache: JobCache, progress: Progress) -> BlurMap:
        """Return the map that the layer holds now."""
        values = np.asarray(self.plane.values(), np.float32)
        known = values[~np.isnan(values)]
        if not known.size or not np.isfinite(known).all() or known.min() < 0:
            raise ValueError(
                f"“{self.plane.name}” is no blur map: it takes finite values from 0 px up."
            )
        confidence = None
        if self.confidence is not None:
            confidence = np.asarray(self.confidence.read(), np.float32)
        return BlurMap(
            name=self.plane.name,
            values=values,
            psf=self._family(float(known.max())),
            confidence=confidence,
            safe=self._safe(picture, values, cache),
        )

    def _safe(self, picture: Picture, values: Float32, cache: JobCache) -> Float32 | None:
        """Return what is safe to take away, if this is the map that an earlier run has made."""
        found = self.made_with and known_map(picture, self.made_with, cache)
        return found.safe if found and np.array_equal(found.values, values) else None

    def _family(self, largest: float) -> PSFFamily:
        from napari_defocus import psf_from_text

        family = psf_of(self.psf, self.max_radius)
        return family if largest <= family.max_scale else psf_from_text(self.psf, largest)

    def described(self, psf: PSFFamily) -> dict[str, Any]:
        """Return what metadata say about it; `psf` is that of the map that it gave."""
        return {"psf": self.psf, "blur_map": self.plane.name}


def source_of_layer(layer: Image, plane: Plane, viewer: ViewerModel, psf: str) -> LayerSource:
    """Return the map that a layer holds for a plane that a viewer shows, or for a part of it.

    The layer has one channel and the axes of the image, or of the plane alone; of a map of the
    whole plane, the same part is taken. `psf` is the family whose scale the map is, if the layer
    does not say it.

    Raises
    ------
    ValueError
        If the layer shows no plane of the same height and width, or one of another part of the
        picture, or the lens cannot be.
    """
    found = plane_on(layer, plane, viewer, "blur map")
    if plane.is_part and not lies_on(layer, found.index, plane):
        raise ValueError(
            f"“{layer.name}” cannot be the blur map of “{plane.name}”: it lies on another part of "
            "it."
        )
    made = settings_of_map(layer)
    return LayerSource(
        plane=found,
        psf=made.psf if made else psf,
        max_radius=made.max_radius if made else MapSettings.max_radius,
        confidence=confidence_of(layer, found, viewer),
        made_with=made,
    )


def plane_on(layer: Image, plane: Plane, viewer: ViewerModel, role: str) -> Plane:
    """Return the plane of a layer that a viewer shows, or the part of it that a plane is.

    Raises
    ------
    ValueError
        If there is none of the same height and width; the message says in which role.
    """
    cannot = f"“{layer.name}” cannot be the {role} of “{plane.name}”"
    try:
        found = _same_part(shown_plane(layer, viewer.dims), plane)
    except NotAnalysableError as reason:
        raise ValueError(f"{cannot}: {reason}") from None
    if found.shape != plane.shape:
        sizes = [f"{height} x {width} px" for height, width in (found.shape, plane.shape)]
        raise ValueError(f"{cannot}: it has {sizes[0]}, the picture {sizes[1]}.")
    return found


def settings_of_map(layer: Image) -> MapSettings | None:
    """Return what a map of ours was estimated with; None if the layer does not say it."""
    if made_by_us(layer) != BLUR_MAP:
        return None
    try:
        return MapSettings(**layer.metadata[METADATA_KEY]["settings"])
    except (KeyError, TypeError, ValueError):
        return None


def may_be_map_of(layer: Any, image: Image) -> bool:
    """Tell whether a layer may hold a blur map of an image layer."""
    if not isinstance(layer, Image) or layer.rgb or layer == image:
        return False
    made = made_by_us(layer)
    if made == BLUR_MAP and layer.metadata[METADATA_KEY].get("source") == image.name:
        return True
    if made not in (None, BLUR_MAP) or np.dtype(layer.dtype).kind != "f":
        return False
    sizes = [finest(found).shape[: found.ndim][-2:] for found in (layer, image)]
    return bool(sizes[0] == sizes[1])


def _same_part(found: Plane, plane: Plane) -> Plane:
    """Return the part of a layer's plane that a plane of the picture is, if it has the whole."""
    return found.at(same_part(found.index, found.data.shape, plane))


def confidence_of(layer: Image, found: Plane, viewer: ViewerModel) -> Plane | None:
    """Return the plane with the confidence of a map, if both come from the same estimation."""
    made = layer.metadata.get(METADATA_KEY, {}) if made_by_us(layer) else {}
    if "source" not in made:
        return None
    results = results_of(viewer.layers, CONFIDENCE, made["source"])
    for confidence in sorted(results, key=lambda result: run_of(result) != run_of(layer)):
        if same_estimation(confidence, layer):
            with suppress(NotAnalysableError):
                plane = _same_part(shown_plane(confidence, viewer.dims), found)
                if plane.shape == found.shape:
                    return plane
    return None
