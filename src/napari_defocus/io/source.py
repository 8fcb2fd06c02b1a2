"""A picture, a stack or a slide that is open, of which no pixels are read yet."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from napari_defocus.core.checks import renamed

if TYPE_CHECKING:
    import dask.array as da


@dataclass(frozen=True, eq=False)
class Source:
    """A picture, or planes of one size, of which pixels are read when they are computed.

    Attributes
    ----------
    path : Path
    data : dask.array.Array
        bool or real numbers. It can be sent to other processes, which open the file themselves.
    axes : str
        A letter an axis of `data`: planes, such as t, c, z, then y, x, then s for colours.
    pixel_size : dict of str to float
        How far apart neighbours are, for axes of which it is known.
    units : dict of str to str
        In the spelling of UDUNITS, such as "micrometer", for axes of which it is known.
    pictures : tuple of Path
        The pictures that are its planes, if it is made of several; see `open_stack`.
    channel_names : tuple of str
        Of the channels along c, if the file is of a microscope's own format and says so.
    """

    path: Path
    data: da.Array
    axes: str
    pixel_size: dict[str, float]
    units: dict[str, str]
    pictures: tuple[Path, ...] = ()
    channel_names: tuple[str, ...] = ()

    @property
    def scale(self) -> dict[str, float]:
        """The old name of `pixel_size`."""
        return renamed("scale", self.pixel_size, "pixel_size", None) or {}

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read: `pictures`, or `path` alone."""
        return self.pictures or (self.path,)

    @property
    def plane_axes(self) -> str:
        """The axes before y and x."""
        return self.axes[: self.axes.index("y")]

    @property
    def plane_shape(self) -> tuple[int, ...]:
        """How many planes there are along each of `plane_axes`; () for a single picture."""
        return tuple(self.data.shape[: len(self.plane_axes)])

    def planes(self) -> Iterator[tuple[int, ...]]:
        """Return the index of every plane, the last axis fastest; one () for a single picture."""
        return iter(np.ndindex(*self.plane_shape))

    def plane(self, index: tuple[int, ...] = ()) -> da.Array:
        """Return a plane, (H, W) or (H, W, 3 or 4), not yet read.

        Raises
        ------
        IndexError
            If there is no such plane.
        """
        sizes = dict(zip(self.plane_axes, self.plane_shape, strict=True))
        within = map(operator.contains, map(range, sizes.values()), index)
        if len(index) != len(sizes) or not all(within):
            extent = ", ".join(f"{axis} 0 to {size - 1}" for axis, size in sizes.items())
            raise IndexError(
                f"index is {index}; the planes of {self.path} are {extent or '() alone'}"
            )
        return self.data[index]

    def label_of(self, index: tuple[int, ...]) -> str:
        """Return a plane's index in words, such as "t=3 z=12"; "" for a single picture."""
        return " ".join(f"{a}={at}" for a, at in zip(self.plane_axes, index, strict=True))
