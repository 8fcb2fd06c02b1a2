"""A picture restored, and seen with another focus: no Qt, any thread."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.checks import Linearize
from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.settings import CONFIDENT, RefocusSettings, RestorationSettings
from napari_defocus.widgets.jobs.cache import fingerprint
from napari_defocus.widgets.jobs.estimation import JobCache, Picture
from napari_defocus.widgets.jobs.map_source import BlurMap, MapSource
from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.result_layers import left_as_it_was_layer
from napari_defocus.widgets.layers.result_metadata import (
    ALL_IN_FOCUS,
    REFOCUSED,
    Results,
    confidence_description,
    noise_description,
    result_layer,
)

if TYPE_CHECKING:
    from napari_defocus.restoration.all_in_focus import RestorationFit

Float32 = NDArray[np.float32]

_LEAST_UNRESTORED = 0.005
_UNRESTORED = "{percent:.0f}% of the picture was left as it was: restored, it would have rings."
_MISFIT = (
    "The lens or the map may not fit this picture. So less blur was taken away, and more was "
    "smoothed than for the noise alone."
)

_LITTLE = 0.5
"""Of the range: 12 bits in 16 would be black."""

_MAP_SHARE = 0.3
_RESTORED = 0.9
"""What share of the time has gone, when the map is known, and when the picture is restored."""


@dataclass(frozen=True, kw_only=True)
class Restoration:
    """An all-in-focus picture that is wanted of a plane.

    Attributes
    ----------
    plane : Plane
    source : MapSource
        Where its blur map comes from.
    settings : RestorationSettings
    linearize : {"srgb"} or None
        Whether the blur is taken away in linear light.
    protect : bool
        Whether places of low confidence are changed less.
    show_left : bool
        Whether a layer of what is left as it was is wanted, too.
    """

    plane: Plane
    source: MapSource
    settings: RestorationSettings
    linearize: Linearize | None = None
    protect: bool = True
    show_left: bool = field(default=False, compare=False)

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the all-in-focus picture as a layer, after those of a map that was estimated."""
        made = self.made(cache, progress)
        layers = _picture_layers(self, made, made.sharp, ALL_IN_FOCUS)
        return Results([*made.blur_map.layers, *layers], self.summary(made))

    def made(self, cache: JobCache, progress: Progress) -> Restored:
        """Return the restored picture: that of an earlier run, if nothing has changed."""
        from napari_defocus import estimate_noise_variance, pipeline
        from napari_defocus.restoration import all_in_focus

        picture = Picture.of(self.plane)
        progress("Reading the picture", 0.0)
        blur_map = self.source.read(picture, cache, within(progress, 0.0, _MAP_SHARE))
        values = blur_map.checked_for_restoration()
        confidence = blur_map.confidence if self.protect else None
        if self.protect and blur_map.safe is not None:
            values = blur_map.safe
        progress("Measuring the noise", _MAP_SHARE)
        noise_variance = self.settings.noise_variance
        if noise_variance is None:
            noise_variance = estimate_noise_variance(picture.image, linearize=self.linearize)
        key = (
            *(*picture.key, fingerprint(values), blur_map.psf, noise_variance),
            *(self.settings.tv_weight, self.linearize),
            None if confidence is None else fingerprint(confidence),
        )

        def restore() -> tuple[Float32, RestorationFit]:
            tv_weight = self.settings.tv_weight
            how = all_in_focus.Restoration(blur_map.psf, noise_variance, tv_weight, self.linearize)
            report = within(progress, _MAP_SHARE, 1.0)
            return picture.call(
                pipeline.restore, picture.image, values, confidence, how, progress=report
            )

        sharp, fit = cache.restored.get(self.plane.layer, key, restore)
        return Restored(picture, blur_map, sharp, fit)

    def summary(self, made: Restored) -> str:
        """Return what there is to say about what was made."""
        lines = []
        if made.fit.misfit > 0:
            lines.append(_MISFIT)
        if made.fit.unrestored >= _LEAST_UNRESTORED:
            lines.append(_UNRESTORED.format(percent=100 * made.fit.unrestored))
        elif self.show_left:
            lines.append("Less than 1% of the picture was left as it was.")
        confidence = made.blur_map.confidence
        if confidence is not None:
            lines.append(confidence_description((confidence >= CONFIDENT).mean()))
        elif self.protect:
            lines.append("Nothing is protected: the map has no confidence layer.")
        lines.append(noise_description(self.settings.noise_variance, [made.fit.noise_variance]))
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Restored:
    """What a restoration has made.

    Attributes
    ----------
    picture : Picture
    blur_map : BlurMap
    sharp : (H, W) or (H, W, 3) float32 ndarray
        In [0, 1].
    fit : RestorationFit
        How well the picture fits its map; the noise and the lambda that were used.
    """

    picture: Picture
    blur_map: BlurMap
    sharp: Float32
    fit: RestorationFit


@dataclass(frozen=True, kw_only=True)
class Refocusing:
    """A picture with another focus that is wanted of a plane.

    Attributes
    ----------
    restoration : Restoration
        What is blurred again.
    view : RefocusSettings
        How.
    """

    restoration: Restoration
    view: RefocusSettings

    @property
    def plane(self) -> Plane:
        """What it is made of."""
        return self.restoration.plane

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the picture as a layer, after those of its map if it was estimated.

        With another view of the same restored picture, that one is only blurred again.
        """
        from napari_defocus import change_focus

        made = self.restoration.made(cache, within(progress, 0.0, _RESTORED))
        progress("Blurring again", _RESTORED)
        seen = made.picture.call(
            change_focus,
            made.picture.image,
            made.blur_map.values,
            focus=self.view.focus,
            aperture=self.view.aperture,
            side=self.view.side,
            psf=made.blur_map.psf,
            all_in_focus=made.sharp,
            linearize=self.view.linearize,
            progress=within(progress, _RESTORED, 1.0),
        )
        layers = _picture_layers(self.restoration, made, seen, REFOCUSED, view=asdict(self.view))
        return Results([*made.blur_map.layers, *layers], self.restoration.summary(made))


def _picture_layers(
    wanted: Restoration, made: Restored, picture: Float32, result: str, **settings: Any
) -> list[LayerDataTuple]:
    """Return a picture in [0, 1] as an image layer that lies on the plane, and what was left."""
    restoration = {"linearize": wanted.linearize, "protect": wanted.protect}
    restoration = asdict(wanted.settings) | restoration
    settings = {
        "map": wanted.source.described(made.blur_map.psf),
        "restoration": restoration,
        **settings,
    }
    facts = {
        "noise_variance": made.fit.noise_variance,
        "misfit": made.fit.misfit,
        "unrestored": made.fit.unrestored,
        "intensities": made.picture.intensities.facts(),
        "blur_map": made.blur_map.name,
    }
    # A copy: what somebody paints on the layer is not cached.
    shown = result_layer(
        *(wanted.plane, result, picture.copy(), settings, facts),
        rgb=picture.ndim == 3,
        contrast_limits=_limits(wanted.plane, made.picture.intensities),
    )
    if not wanted.show_left:
        return [shown]
    left = made.fit.left_as_it_was.copy()
    return [shown, left_as_it_was_layer(wanted.plane, left, settings, facts)]


def _limits(plane: Plane, intensities: Intensities) -> tuple[float, float]:
    """Return how a picture in [0, 1] is shown: as its plane, if that fills little of the range."""
    low, high = ((limit - intensities.low) / intensities.span for limit in plane.contrast_limits)
    return (low, high) if 0 < high - low < _LITTLE else (0.0, 1.0)
