"""What one run does with a stack through focus: the sharpest plane of each pixel. No Qt."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.axes import known_axis
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.core.worker_process import run_elsewhere
from napari_defocus.io.lazy_arrays import Carried
from napari_defocus.io.tiff_pixel_size import MICROMETERS
from napari_defocus.settings import CONFIDENT, MapSettings
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.tiled_job import as_dask
from napari_defocus.widgets.layers.flat_placement import of_all_planes
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane, check_pixels
from napari_defocus.widgets.layers.result_metadata import (
    ALIGNMENT,
    AT,
    BEST_FOCUS,
    FOCUS_CONFIDENCE,
    HEIGHT,
    METADATA_KEY,
    SHARPEST,
    Results,
    confidence_description,
    result_layer,
)

if TYPE_CHECKING:
    from napari_defocus.stacks.alignment import StackAlignment
    from napari_defocus.stacks.focus_stacking import SharpestPlane

Choice = Literal["auto"] | bool
Peak = Literal["strongest", "first", "last"]

COLOR_MAP = "turbo"
"""Positions have no best end, unlike a blur."""

NO_PLANES = "it has no planes beside the one that is shown."
CHANNELS_ONLY = (
    "channels are no planes through focus. If these are planes, call their axis z "
    "(the layer's axis_labels)."
)


@dataclass(frozen=True, kw_only=True)
class FocusStacking:
    """Where each pixel of a stack is in focus, and a picture of the sharpest pixels.

    Attributes
    ----------
    plane : Plane
        One of the stack, or a part of it; the others lie along `axis`.
    axis : int
        Of the layer: along which the focus changes.
    settings : MapSettings
        Lens, noise, smoothness; its window and stride are not used.
    px_per_plane : float or None
        By how many px the radius grows from plane to plane; None to find it.
    align, match_brightness : "auto" or bool
        Whether planes are laid on each other first, and made equally bright.
    laid : StackAlignment or None
        How planes are laid on each other, found before; it counts more than `align`.
    blend : bool
        Whether planes are blended, or each pixel is that of one plane.
    peak : {"strongest", "first", "last"}
        Which plane is meant where two are sharp.
    also : Plane or None
        Of another stack of the same scene, such as another channel, which is put together at the
        positions that this one tells.

    Examples
    --------
    In a script, without a window:

    >>> import numpy as np
    >>> from napari.components import ViewerModel
    >>> from napari_defocus.widgets.jobs.estimation import JobCache
    >>> from napari_defocus.widgets.layers.image_layers import shown_plane
    >>> from napari_defocus.widgets.display.add_results import add_results
    >>> viewer = ViewerModel()
    >>> stack = viewer.add_image(np.random.default_rng(0).random((3, 60, 70)), name="sweep")
    >>> plane = shown_plane(stack, viewer.dims)
    >>> wanted = FocusStacking(plane=plane, axis=0, settings=MapSettings())
    >>> [layer.name for layer in add_results(viewer, wanted.run(JobCache()).layers)]
    ['sweep sharpest', 'sweep best focus (plane)', 'sweep best focus confidence']
    """

    plane: Plane
    axis: int
    settings: MapSettings
    px_per_plane: float | None = None
    align: Choice = "auto"
    match_brightness: Choice = "auto"
    laid: StackAlignment | None = None
    blend: bool = True
    peak: Peak = "strongest"
    also: Plane | None = None

    def __post_init__(self) -> None:
        """Refuse, before any work is done, what cannot be."""
        self.settings.family()
        if not isinstance(self.plane.index[self.axis], int):
            raise NotAnalysableError("the focus must change along a slider of it.")
        if known_axis(self._label_of_axis) == "c":
            raise NotAnalysableError(CHANNELS_ONLY)
        if self.count < 2:
            raise NotAnalysableError("it has a single plane there; two or more are compared.")
        if self.px_per_plane is not None and not 0 < self.px_per_plane < np.inf:
            raise ValueError(
                f"The px a plane are “{self.px_per_plane:g}”. Type a number above 0, or leave "
                "the field empty to have it found."
            )
        check_pixels(self.plane.shape)
        if self.laid is not None:
            self.laid.check_fits(self.plane.shape, self.count)
        if self.also is not None:
            other = self._of(self.also)
            if (other.plane.shape[:2], other.count) != (self.plane.shape[:2], self.count):
                raise NotAnalysableError(
                    f"the other stack has {other.count} planes of {other.plane.shape[0]} x "
                    f"{other.plane.shape[1]} px; it takes {self.count} of "
                    f"{self.plane.shape[0]} x {self.plane.shape[1]} px."
                )

    def _of(self, plane: Plane) -> FocusStacking:
        """Return the same of another stack."""
        return replace(self, plane=plane, also=None)

    @property
    def _label_of_axis(self) -> str:
        return str(self.plane.placement["axis_labels"][self.axis])

    @property
    def count(self) -> int:
        """How many planes are compared."""
        return int(self.plane.data.shape[self.axis])

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the picture, the positions and their confidence as layers.

        Raises
        ------
        ValueError
            If a plane has infinite pixels.
        """
        progress("Reading the planes", 0.0)
        settings = self.settings
        found = run_elsewhere(
            sharpest_of,
            Carried(self._stack()),
            progress=within(progress, 0.0, 0.7 if self.also else 1.0),
            axes=self._axes(),
            px_per_plane=self.px_per_plane,
            psf=settings.family(),
            noise_variance=settings.noise_variance,
            smoothness=settings.smoothness,
            color_sigma=settings.color_sigma,
            linearize=settings.linearize,
            align=self.align if self.laid is None else self.laid,
            match_brightness=self.match_brightness,
            blend=self.blend,
            peak=self.peak,
        )
        layers = self._layers(found)
        if self.also is not None:
            other = self._of(self.also)
            composite = run_elsewhere(
                composite_of,
                Carried(other._stack()),
                found.position,
                progress=within(progress, 0.7, 1.0),
                axes=other._axes(),
                alignment=found.alignment,
                px_per_plane=found.px_per_plane if np.isfinite(found.px_per_plane) else 1.0,
                psf=settings.family(),
                blend=self.blend,
            )
            layers.append(other._layer_of_pixels(found, composite))
        return Results(layers, self._summary(found))

    def _stack(self) -> Any:
        index = list(self.plane.index)
        index[self.axis] = slice(None)
        data = self.plane.data
        # Zarr reads at an index; dask's arrays, and views of numpy's, wait until they are asked.
        if not isinstance(data, np.ndarray):
            data = as_dask(data, self._axes_of_data())
        return data[tuple(index)]

    def _axes_of_data(self) -> str:
        picture = iter("yx")
        letters = (next(picture) if isinstance(at, slice) else "p" for at in self.plane.index)
        own = "".join(letters)
        return own + "s" * (self.plane.data.ndim - len(own))

    def _axes(self) -> str:
        """Return the letters of the axes of the stack."""
        picture = iter("yx")
        own = "".join(
            "z" if axis == self.axis else next(picture)
            for axis, at in enumerate(self.plane.index)
            if axis == self.axis or isinstance(at, slice)
        )
        return own + "s" * (self.plane.data.ndim - len(self.plane.index))

    def _layers(self, found: SharpestPlane) -> list[LayerDataTuple]:
        last = float(self.count - 1)
        position: dict[str, Any] = {"colormap": COLOR_MAP, "contrast_limits": (0.0, last)}
        sure: dict[str, Any] = {"colormap": "gray", "contrast_limits": (0.0, 1.0)}
        hidden = {"visible": False}
        return [
            self._layer_of_pixels(found, found.composite),
            self._layer(
                *(found, BEST_FOCUS, found.position),
                name="best focus (plane)",
                **(position | hidden),
            ),
            self._layer(found, FOCUS_CONFIDENCE, found.confidence, **(sure | hidden)),
            *self._height_layer(found),
        ]

    @property
    def z_step_um(self) -> float | None:
        """How far planes are apart in um, if the layer's scale and units say it."""
        unit = MICROMETERS.get(str(self.plane.placement["units"][self.axis]))
        return None if unit is None else unit * float(self.plane.placement["scale"][self.axis])

    def _height_layer(self, found: SharpestPlane) -> list[LayerDataTuple]:
        """Return the positions as heights above the first plane in um, if the step is known."""
        step = self.z_step_um
        if step is None:
            return []
        ends = tuple(sorted((0.0, step * (self.count - 1))))
        looks = {"colormap": COLOR_MAP, "contrast_limits": ends, "visible": False}
        heights = found.height_um(step)
        return [self._layer(found, HEIGHT, heights, name="height of best focus (µm)", **looks)]

    def _alignment(self, found: SharpestPlane) -> StackAlignment:
        """Return how the planes lie on each other, also if none has moved."""
        from napari_defocus import StackAlignment

        return found.alignment or StackAlignment.still(self.plane.shape, self.count)

    def _layer_of_pixels(self, found: SharpestPlane, composite: NDArray[Any]) -> LayerDataTuple:
        rgb = composite.ndim == 3
        limits = {} if rgb else {"contrast_limits": self.plane.contrast_limits}
        return self._layer(found, SHARPEST, composite, name="sharpest", rgb=rgb, **limits)

    def _layer(
        self, found: SharpestPlane, result: str, values: NDArray[Any], **looks: Any
    ) -> LayerDataTuple:
        own = ("px_per_plane", "axis", "align", "match_brightness", "blend", "peak")
        settings = asdict(self.settings) | {name: getattr(self, name) for name in own}
        if self.laid is not None:
            settings["align"] = "as given"
        facts = {
            "noise_variance": found.noise_variance,
            "intensities": found.intensities.facts(),
            "px_per_plane": found.px_per_plane,
            "share_of_plane": found.share_of_plane.tolist(),
            "gain": found.gain.tolist(),
            ALIGNMENT: self._alignment(found).as_dict(),
            "notes": list(found.notes),
        }
        layer = result_layer(self.plane, result, values, settings, facts, **looks)
        placed = of_all_planes(self.plane.placement) if self._is_plain else None
        if placed is None:
            return layer
        _, keywords, kind = layer
        keywords["metadata"][METADATA_KEY][AT] = [None, None]
        return LayerDataTuple((values, keywords | placed, kind))

    @property
    def _is_plain(self) -> bool:
        """Whether the stack has one slider, before its rows and columns."""
        return len(self.plane.index) == 3 and self.axis == 0

    def _summary(self, found: SharpestPlane) -> str:
        share = found.share_of_plane[found.best]
        lines = [f"Plane {found.best} (from 0) is the sharpest on {share:.0%}"]
        if np.isfinite(found.px_per_plane):
            how = "found" if self.px_per_plane is None else "given"
            lines.append(f"The blur grows by {found.px_per_plane:.2f} px a plane ({how})")
        else:
            lines.append("There is no texture to find by how much the blur grows.")
        lines += found.notes
        lines.append(confidence_description((found.confidence >= CONFIDENT).mean()))
        if known_axis(self._label_of_axis) == "t":
            lines.append(f"“{self._label_of_axis}” was taken for focus")
        return "\n".join(lines)


def sharpest_of(stack: Carried, *, progress: Progress, **settings: Any) -> SharpestPlane:
    """Return `napari_defocus.sharpest_plane` of a stack that was sent: in another process."""
    from napari_defocus import sharpest_plane

    return sharpest_plane(stack.array, progress=progress, **settings)


def composite_of(
    stack: Carried, position: NDArray[np.float32], *, progress: Progress, **settings: Any
) -> NDArray[Any]:
    """Return `napari_defocus.composite_at` of a stack that was sent: in another process."""
    from napari_defocus import composite_at

    return composite_at(position, stack.array, progress=progress, **settings)
