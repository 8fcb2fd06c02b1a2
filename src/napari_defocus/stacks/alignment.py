"""How the planes of a stack lie on one of them: shift, magnification and turn, kept in a file."""

from __future__ import annotations

import cmath
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import affine_transform

import napari_defocus
from napari_defocus.core.image import given_reals, nearest_known
from napari_defocus.core.writing import write_results

Float64 = NDArray[np.float64]

VERSION_KEY = "napari_defocus"

_KEYS = ("shift_rows", "shift_columns", "magnification", "turn_degrees", "uncertainty_px")
_TAKES = "it takes a file that StackAlignment.save wrote"

_ALL_KNOWN = 0.999
"""The share of an interpolated pixel's sources that must be known: all, less rounding."""

SPLINE = 5
"""Order of the splines between pixels. Half a pixel and back costs pictures that a camera has
softened by 0.5 px (standard deviation) 45 to 51 dB with order 3, 46 to 53 dB with order 5, 37 to
43 dB with order 1.
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class StackAlignment:
    r"""How the planes of a stack lie on one of them, the reference.

    What the reference shows at a pixel :math:`\mathbf{x}`, plane z shows at

    .. math:: \mathbf{c} + m_z R(\varphi_z) (\mathbf{x} - \mathbf{c}) + \mathbf{t}_z

    where c is the middle of the plane, m the magnification (a lens that is focused changes it),
    R a turn and t a shift.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the planes in px.
    reference : int
        The plane on which the others are laid, from 0.
    shift : (Z, 2) array_like
        t, along rows and columns, in px.
    magnification : (Z,) array_like
        m, 1 for the reference.
    turn : (Z,) array_like
        In degrees, from the rows' direction (down) to that of the columns (right).
    uncertainty : (Z,) array_like
        Standard error of where the corners are, in px; 0 if nothing was measured.

    Raises
    ------
    TypeError
        If one of these holds no real numbers.
    ValueError
        If the numbers do not belong together, are not finite, or a magnification is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import StackAlignment
    >>> still = StackAlignment.still((100, 120), planes=5)
    >>> still.largest_motion
    0.0
    >>> moved = StackAlignment(
    ...     shape=(100, 120), reference=0, shift=np.array([[0, 0], [1.5, -2]]),
    ...     magnification=np.ones(2), turn=np.zeros(2), uncertainty=np.zeros(2),
    ... )
    >>> moved.largest_motion
    2.5
    """

    shape: tuple[int, int]
    reference: int
    shift: Float64
    magnification: Float64
    turn: Float64
    uncertainty: Float64

    def __post_init__(self) -> None:
        """Refuse what is no alignment."""
        for name in ("shift", "magnification", "turn", "uncertainty"):
            object.__setattr__(self, name, given_reals(name, getattr(self, name)))
        count = len(self.magnification)
        numbers = (self.shift.ravel(), self.magnification, self.turn, self.uncertainty)
        sizes = [each.size for each in numbers] != [2 * count, count, count, count]
        if sizes or not 0 <= self.reference < count:
            raise ValueError(
                f"an alignment of {count} planes has reference {self.reference} and "
                f"{[each.size for each in numbers]} numbers; it takes two shifts, a "
                "magnification, a turn and an uncertainty for each plane"
            )
        if not all(np.isfinite(each).all() for each in numbers) or self.magnification.min() <= 0:
            raise ValueError("an alignment takes finite numbers, and magnifications above 0")

    @classmethod
    def still(cls, shape: tuple[int, int], planes: int) -> Self:
        """Return that of planes that have not moved."""
        zeros = np.zeros(planes)
        return cls(
            shape=shape,
            reference=planes // 2,
            shift=np.zeros((planes, 2)),
            magnification=np.ones(planes),
            turn=zeros,
            uncertainty=zeros,
        )

    def __len__(self) -> int:
        """Count the planes."""
        return len(self.magnification)

    @property
    def motion(self) -> Float64:
        """How far the pixel that moves most has moved, for each plane: (Z,) px."""
        corners = np.array([complex(*corner) for corner in self._corners()])
        factors = self.magnification * np.exp(1j * np.deg2rad(self.turn))
        shifts = self.shift[:, 0] + 1j * self.shift[:, 1]
        moved = (factors[:, None] - 1) * corners + shifts[:, None]
        return np.asarray(np.abs(moved).max(axis=1))

    @property
    def largest_motion(self) -> float:
        """The largest of `motion`, in px."""
        return float(self.motion.max())

    @property
    def is_still(self) -> bool:
        """Whether no plane moves."""
        return self.largest_motion == 0

    def aligned(self, values: NDArray[Any], number: int, order: int = SPLINE) -> NDArray[Any]:
        """Lay values of a plane on the reference, by splines; NaN where the plane has none.

        Parameters
        ----------
        values : (H, W) floating ndarray
        number : int
            Of the plane.
        order : int, optional
            Of the splines.

        Returns
        -------
        (H, W) ndarray of the same dtype
        """
        factor = self.magnification[number] * cmath.rect(1.0, math.radians(self.turn[number]))
        return moved(values, factor, complex(*self.shift[number]), order)

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write it into a JSON file, whole or not at all.

        Parameters
        ----------
        path : path-like
        force : bool, optional
            Whether a file that exists is overwritten.

        Raises
        ------
        TypeError
            If `force` is neither True nor False.
        OSError
            If the file exists and `force` is not set, or cannot be written.
        """
        write_results({Path(path): self.encoded()}, force=force)

    def encoded(self) -> bytes:
        """Return what `save` writes."""
        return f"{json.dumps(self.as_dict(), indent=2)}\n".encode()

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON holds them, for `from_dict`."""
        columns = (*self.shift.T, self.magnification, self.turn, self.uncertainty)
        planes = [
            dict(zip(_KEYS, map(float, row), strict=True)) for row in zip(*columns, strict=True)
        ]
        return {
            VERSION_KEY: napari_defocus.__version__,
            "height": int(self.shape[0]),
            "width": int(self.shape[1]),
            "reference": int(self.reference),
            "planes": planes,
        }

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Self:
        """Return what `as_dict` was called on.

        Raises
        ------
        KeyError, IndexError, TypeError, ValueError
            If it is something else.
        """
        planes: Sequence[dict[str, float]] = content["planes"]
        table = np.array([[float(plane[key]) for key in _KEYS] for plane in planes])
        return cls(
            shape=(int(content["height"]), int(content["width"])),
            reference=int(content["reference"]),
            shift=table[:, :2],
            magnification=table[:, 2],
            turn=table[:, 3],
            uncertainty=table[:, 4],
        )

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read what `save` wrote.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it holds no alignment; the message has the file and what is missing.
        """
        try:
            return cls.from_dict(json.loads(Path(path).read_text(encoding="utf-8-sig")))
        except FileNotFoundError:
            raise FileNotFoundError(f"cannot read {path}: there is no such file") from None
        except KeyError as error:
            raise ValueError(f"cannot read {path}: it has no {error}; {_TAKES}") from None
        except (IndexError, OSError, TypeError, ValueError) as error:
            raise ValueError(f"cannot read {path}: {error}; {_TAKES}") from None

    def check_fits(self, shape: tuple[int, int], planes: int) -> None:
        """Refuse planes of another size, or another number of them.

        Raises
        ------
        ValueError
        """
        if (*self.shape, len(self)) != (*shape, planes):
            raise ValueError(
                f"The alignment is of {len(self)} planes of {self.shape[0]} x {self.shape[1]} px; "
                f"the stack has {planes} of {shape[0]} x {shape[1]} px"
            )

    def _corners(self) -> Float64:
        half = (np.array(self.shape) - 1) / 2
        return np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * half

    def __str__(self) -> str:
        """Say how much the planes move, in a line."""
        if self.is_still:
            return "not moved"
        parts = []
        along = np.hypot(*self.shift.T).max()
        if along > 0:
            parts.append(f"shifts up to {along:.2f} px")
        zoom = np.abs(self.magnification - 1).max()
        if zoom > 0:
            parts.append(f"magnification up to {100 * zoom:.2f} %")
        turn = np.abs(self.turn).max()
        if turn > 0:
            parts.append(f"turns up to {turn:.2f} degrees")
        return f"{', '.join(parts)}; {self.largest_motion:.1f} px at most"


def moved(
    values: NDArray[Any], factor: complex, shift: complex, order: int = SPLINE
) -> NDArray[Any]:
    """Return what a plane shows at ``factor x + shift`` for each pixel x, by splines.

    Places are complex numbers from the plane's middle, rows the real part. NaN where it has none,
    and where it is NaN itself: splines would carry that through whole rows.
    """
    if factor == 1 and shift == 0:
        return values.copy()
    middle = (np.array(values.shape) - 1) / 2
    matrix = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
    offset = middle - (matrix * middle).sum(axis=1) + (shift.real, shift.imag)

    def laid(plane: NDArray[Any], order: int) -> NDArray[Any]:
        return np.asarray(
            affine_transform(plane, matrix, offset, order=order, mode="constant", cval=np.nan)
        )

    known = np.isfinite(values)
    if known.all() or not known.any():
        return laid(values, order) if known.all() else np.full_like(values, np.nan)
    found = laid(nearest_known(values, known), order)
    found[~(laid(known.astype(np.float32), 1) > _ALL_KNOWN)] = np.nan
    return found
