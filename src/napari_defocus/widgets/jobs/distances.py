"""Distances from a blur map, as an image and as a surface: no Qt, any thread."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.types import LayerDataTuple
from napari.utils.colormaps import Colormap, ensure_colormap
from napari.utils.transforms import Affine, CompositeAffine
from numpy.typing import NDArray

from napari_defocus.core.checks import Side, check_confidence
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.jobs.estimation import JobCache, Picture
from napari_defocus.widgets.jobs.map_source import BlurMap, MapSource
from napari_defocus.widgets.layers.image_layers import Plane, picture_axes
from napari_defocus.widgets.layers.result_metadata import (
    DEPTH,
    DEPTH_SURFACE,
    Results,
    provenance,
    result_layer,
)

if TYPE_CHECKING:
    from napari_defocus import DepthSurface, ThinLens

Float32 = NDArray[np.float32]

COLOR_MAP = "plasma"
UNKNOWN_COLOR = (0.15, 0.15, 0.15, 1.0)

_SHOWN = (1, 99)
"""Between which percentiles of the distances the colours change."""

_MAP_SHARE = 0.9

_NAN = "not known: no blur is known there, or its confidence is below min_confidence"
_INFINITY = "more blurred than the lens makes anything beyond the focus"


@dataclass(frozen=True, kw_only=True)
class Distances:
    """Distances that are wanted of a plane.

    Attributes
    ----------
    plane : Plane
    source : MapSource
        Where its blur map comes from.
    lens : ThinLens
        What took the picture.
    side : {"far", "near"}
        On which side of the focus everything blurred lies.
    min_confidence : float
        Distances are unknown where the map's confidence is below.
    surface : bool
        Whether a surface is wanted, too.
    """

    plane: Plane
    source: MapSource
    lens: ThinLens
    side: Side = "far"
    min_confidence: float = CONFIDENT
    surface: bool = False

    def __post_init__(self) -> None:
        """Refuse, before any work is done, what cannot be."""
        check_confidence("min_confidence", self.min_confidence)
        if self.side == "far" and math.isinf(self.lens.focus_distance_m):
            raise ValueError(
                "Nothing lies behind a focus at infinity: say that what is blurred lies before "
                "it, or give another focus distance."
            )

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the distances as a layer, after those of the map if it was estimated."""
        picture = Picture.of(self.plane)
        progress("Reading the picture", 0.0)
        blur_map = self.source.read(picture, cache, within(progress, 0.0, _MAP_SHARE))
        progress("From blur to distance", _MAP_SHARE)
        depth = self._depth(blur_map)
        layers, lines = [self._depth_layer(depth, blur_map)], [_summary(depth)]
        if self.surface:
            progress("Making the surface", _MAP_SHARE)
            try:
                layers.append(self._surface_layer(depth, picture, blur_map))
            except ValueError:
                lines.append("No surface: distances jump from every pixel to the next.")
        return Results([*blur_map.layers, *layers], "\n".join(lines))

    def _depth(self, blur_map: BlurMap) -> Float32:
        """Return the distances in m, NaN where they are not known."""
        from napari_defocus import depth_from_blur

        depth = depth_from_blur(blur_map.values, self.lens, side=self.side)
        if blur_map.confidence is not None:
            depth[blur_map.confidence < self.min_confidence] = np.nan
        if np.isnan(depth).all():
            raise ValueError(
                f"no pixel has a confidence of {self.min_confidence:g} or more. Lower "
                "“unknown below confidence”."
            )
        return depth

    def _settings(self, blur_map: BlurMap) -> dict[str, Any]:
        return {
            "map": self.source.described(blur_map.psf),
            "lens": asdict(self.lens),
            "side": self.side,
            "min_confidence": self.min_confidence,
        }

    def _depth_layer(self, depth: Float32, blur_map: BlurMap) -> LayerDataTuple:
        facts = {"blur_map": blur_map.name, "unit": "m", "nan": _NAN, "infinity": _INFINITY}
        return result_layer(
            *(self.plane, DEPTH, depth, self._settings(blur_map), facts),
            name="depth (m)",
            colormap=_colors(),
            contrast_limits=_limits(depth),
        )

    def _surface_layer(self, depth: Float32, picture: Picture, blur_map: BlurMap) -> LayerDataTuple:
        from napari_defocus import depth_surface

        surface = depth_surface(depth, picture.image)
        vertices, faces, colors = above(surface, self.plane)
        keywords = {
            "name": f"{self.plane.name} depth surface",
            "vertex_colors": colors,
            "shading": "none",
            "metadata": provenance(
                *(self.plane, DEPTH_SURFACE, self._settings(blur_map)),
                blur_map=blur_map.name,
                height="a relief towards the camera, no scale model",
            ),
            **upright(self.plane),
        }
        return LayerDataTuple(((vertices, faces), keywords, "surface"))


def _summary(depth: Float32) -> str:
    lines = []
    finite = depth[np.isfinite(depth)]
    if finite.size:
        near, far = np.percentile(finite, _SHOWN)
        lines.append(f"Distances {near:.3g} to {far:.3g} m")
    for share, what in (
        (np.isnan(depth).mean(), "Not known on {}"),
        (
            np.isinf(depth).mean(),
            f"Infinite on {{}}: {_INFINITY}. Is the lens right, and the side?",
        ),
    ):
        if share:
            lines.append(what.format(f"{share:.0%}" if share >= 0.005 else "less than 1%"))
    return "\n".join(lines)


def _colors() -> Colormap:
    """Return the colours of distances; where none is known, no other layer shows through."""
    usual = ensure_colormap(COLOR_MAP)
    name = f"{COLOR_MAP}, grey where unknown"
    return Colormap(usual.colors, name=name, nan_color=UNKNOWN_COLOR)


def _limits(depth: Float32) -> tuple[float, float]:
    """Return the distances that the colours begin and end with."""
    finite = depth[np.isfinite(depth)]
    if not finite.size:
        return (0.0, 1.0)
    near, far = (float(distance) for distance in np.percentile(finite, _SHOWN))
    return (near, far) if near < far else (0.99 * near, 1.01 * far)


def _axes(plane: Plane) -> tuple[int, int, int]:
    """Return along which axes of the surface its height, rows and columns run."""
    rows, columns = picture_axes(plane.index)
    if len(plane.index) == 2:
        return 0, 1, 2
    return max(plane.sliders), rows, columns


def above(surface: DepthSurface, plane: Plane) -> tuple[Float32, NDArray[np.int32], Float32 | None]:
    """Return the corners, triangles and colours of a surface that lies above a plane.

    It begins a pixel above: seen from above in 2-D, at the height of the plane, nothing of it
    covers the plane. One more corner, of no triangle, keeps that height among the viewer's.
    """
    corners = np.zeros((1 + len(surface.vertices), max(3, len(plane.index))), np.float32)
    axes = _axes(plane)
    corners[1:, axes] = surface.vertices
    corners[1:, axes[0]] += 1 - surface.vertices[:, 0].min()
    colors = surface.colors
    if colors is not None:
        colors = np.concatenate([colors[:1], colors])
    return corners, surface.faces + 1, colors


def upright(plane: Plane) -> dict[str, Any]:
    """Return where a surface on a plane lies: pixels of height are as long as the plane's."""
    placed = plane.placement
    in_layer = CompositeAffine(
        **{name: placed[name] for name in ("scale", "translate", "rotate", "shear")},
        ndim=len(plane.index),
    )
    # A plane without a third axis gets one before its own.
    world = Affine(affine_matrix=placed["affine"]).compose(in_layer)
    new = 3 - min(3, len(plane.index))
    matrix = np.eye(len(plane.index) + new + 1)
    matrix[new:, new:] = world.affine_matrix
    height, rows, columns = _axes(plane)
    pixel = np.sqrt(np.prod(np.linalg.norm(matrix[:-1, [rows, columns]], axis=0)))
    matrix[:-1, height] = 0
    matrix[height, height] = pixel
    return {
        "affine": matrix,
        "units": (*placed["units"][:new], *placed["units"]),
        "axis_labels": (*("height",) * new, *placed["axis_labels"]),
    }
