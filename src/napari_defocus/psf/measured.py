"""A PSF family from kernels that were measured at some scales."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import convolve

import napari_defocus
from napari_defocus.psf import BLUR_RADIUS
from napari_defocus.psf.checks import check_largest, checked_kernels, checked_scale, real_array
from napari_defocus.psf.pixel_areas import corners_to

Float64 = NDArray[np.floating]

_SMALLEST_RATIO = 1e-3
"""The smallest factor by which a kernel is scaled. Chosen by hand."""

_INVISIBLE = 1e-6
"""Borders darker than this share of the largest value are cut off. Chosen by hand."""

_LARGEST_FILE = 2**30
"""Bytes that a file may unpack to; 100 kernels of 501 px are 0.2 GB."""

_FORMAT = "napari-defocus measured PSF, 1"
"""The name of the format, as our files state it."""


@dataclass(frozen=True, init=False, eq=False, repr=False)
class MeasuredPSF:
    r"""A family from kernels that were measured at some scales, as `calibrate_psf` makes it.

    The PSF of a lens is its aperture, scaled, and the largest kernel shows the aperture best. So it
    is scaled down to every scale. A smaller measured kernel differs from the larger ones scaled
    down. This difference is scaled and added: in full below its own scale, and fading linearly
    towards the next larger one. So each measured kernel is reproduced exactly. Below the smallest
    one the kernel shrinks to a point, and above the largest one it grows.

    With the kernels :math:`h_m` measured at :math:`r_1 < \ldots < r_M`, and :math:`S_q` for what
    scales a kernel by q and keeps its sum,

    .. math::
        d_m = h_m - \sum_{k > m} S_{r_m / r_k} d_k, \qquad
        h(r) = \sum_{k \ge m} S_{r / r_k} d_k
        + \frac{r_m - r}{r_m - r_{m-1}} S_{r / r_{m-1}} d_{m-1}
        \quad \text{for } r_{m-1} < r \le r_m

    A kernel measured at scale 0 is the blur of the lens in focus. It does not shrink: below the
    smallest of the others, it is convolved with them as they shrink.

    Kernels are scaled by cubic splines through their cumulative sums, which are known at the
    corners of the pixels.

    Parameters
    ----------
    scales : (M,) array_like
        Increasing, from 0 px up.
    kernels : (M, K, K) array_like
        One for each scale; K odd, finite, non-negative, centred.
    max_scale : float, optional
        Largest scale that is looked for, in px; the largest measured one by default.
    provenance : mapping, optional
        What the kernels were made from, in a form that JSON can hold. Equality ignores it.

    Attributes
    ----------
    scales : (M,) float64 ndarray
    kernels : (M, K, K) float64 ndarray
        Each of sum 1.
    max_scale : float
    provenance : dict

    Raises
    ------
    TypeError, ValueError
        If an argument is not as described, or `max_scale` below 1 px.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import Disc
    >>> kernels = [np.pad(Disc().kernel(r), 4 - r) for r in (1, 2, 4)]
    >>> lens = MeasuredPSF([1, 2, 4], kernels)
    >>> np.allclose(lens.kernel(2.0), Disc().kernel(2.0))
    True
    >>> lens.kernel(1.5)[3:6, 3:6].round(2)
    array([[0.08, 0.13, 0.08],
           [0.13, 0.14, 0.13],
           [0.08, 0.13, 0.08]])
    >>> Disc().kernel(1.5).round(2)
    array([[0.08, 0.14, 0.08],
           [0.14, 0.14, 0.14],
           [0.08, 0.14, 0.08]])
    """

    scales: NDArray[np.float64]
    kernels: NDArray[np.float64]
    max_scale: float
    provenance: Mapping[str, Any]

    def __init__(
        self,
        scales: ArrayLike,
        kernels: ArrayLike,
        *,
        max_scale: float | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        checked_scales = _checked_scales(scales)
        stack = checked_kernels(kernels, 3, "kernels hold", "one kernel a scale")
        if len(stack) != len(checked_scales):
            raise ValueError(
                f"kernels hold {len(stack)} kernels; it takes one for each of "
                f"{len(checked_scales)} scales"
            )
        largest = float(checked_scales[-1]) if max_scale is None else max_scale
        check_largest("max_scale", largest)
        for array in (checked_scales, stack):
            array.setflags(write=False)
        object.__setattr__(self, "scales", checked_scales)
        object.__setattr__(self, "kernels", stack)
        object.__setattr__(self, "max_scale", largest)
        object.__setattr__(self, "provenance", _checked_provenance(provenance))

    @property
    def scale_name(self) -> str:
        """What the scale measures: the blur radius if `calibrate_psf` found it, or what you say."""
        return BLUR_RADIUS if self.provenance.get("scales_were") == "measured" else "scale (px)"

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the kernel at `scale` (px), between those that were measured; sum 1."""
        scale = checked_scale(scale)
        first = self._first_aperture
        above = int(np.clip(np.searchsorted(self.scales, scale), first, len(self.scales) - 1))
        kernel = self._sum_scaled(self._details[above:], scale)
        if above > first and scale < self.scales[above]:
            below = self.scales[above - 1]
            share = (self.scales[above] - scale) / (self.scales[above] - below)
            kernel += share * self._scaled(self._details[above - 1], scale / below, scale)
        kernel = np.maximum(kernel, 0)
        if above == first == 1:
            # As much of the variance in focus as is lost when the kernel shrinks.
            lost = max(1 - (scale / self.scales[1]) ** 2, 0.0)
            focus = lost * _trimmed(self.kernels[0])
            focus[len(focus) // 2, len(focus) // 2] += 1 - lost
            kernel = convolve(kernel, focus, method="direct")
        return _trimmed(kernel)

    @property
    def _first_aperture(self) -> int:
        return int(self.scales[0] == 0)

    @cached_property
    def _details(self) -> NDArray[np.float64]:
        """What each kernel has beyond the larger ones scaled down; the last has all: (M, K, K)."""
        details = self.kernels.copy()
        for index in range(len(details) - 2, self._first_aperture - 1, -1):
            details[index] -= self._sum_scaled(details[index + 1 :], self.scales[index])
        return details

    def _sum_scaled(self, details: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
        """Scale the details of the largest measured scales to another one and add them up."""
        measured = self.scales[-len(details) :]
        parts = zip(details, scale / measured, strict=True)
        return np.sum([self._scaled(detail, ratio, scale) for detail, ratio in parts], axis=0)

    def _scaled(
        self, detail: NDArray[np.float64], ratio: float, scale: float
    ) -> NDArray[np.float64]:
        """Scale a kernel, whose sum stays, in a frame that is large enough for a scale."""
        half = len(detail) / 2
        corners = corners_to(half * max(scale / self.scales[-1], 1.0))
        corners = np.concatenate([-corners[::-1], corners]) / max(ratio, _SMALLEST_RATIO)
        rows = np.diff(self._sums_up_to(np.clip(corners, -half, half)), axis=0)
        return np.einsum("ai,bi->ab", np.einsum("ai,ij->aj", rows, detail), rows)

    @cached_property
    def _sums_up_to(self) -> BSpline:
        """Map a place on an axis to the weight that each pixel has in the sum up to it."""
        side = self.kernels.shape[1]
        sums = np.tri(side + 1, side, -1)
        return make_interp_spline(np.arange(side + 1) - side / 2, sums, bc_type="clamped")

    @cached_property
    def _digest(self) -> bytes:
        content = (self.scales, np.float64(self.max_scale), self.kernels)
        return hashlib.sha256(b"".join(part.tobytes() for part in content)).digest()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeasuredPSF):
            return NotImplemented
        return self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def __repr__(self) -> str:
        side = self.kernels.shape[1]
        return (
            f"MeasuredPSF({len(self.scales)} kernels of {side} x {side} px, measured from "
            f"{self.scales[0]:.2f} to {self.scales[-1]:.2f} px)"
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write the family into one .npz file, whole or not at all; an old one is replaced.

        Raises
        ------
        OSError
            If the file cannot be written; the message has the path and the reason.
        """
        from napari_defocus.core.writing import write_results

        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            format=np.array(_FORMAT),
            version=np.array(napari_defocus.__version__),
            scales=self.scales,
            kernels=self.kernels,
            max_scale=np.array(self.max_scale),
            provenance=np.array(json.dumps(self.provenance)),
        )
        write_results({Path(path): buffer.getvalue()}, force=True)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> MeasuredPSF:
        """Read a family that `save` wrote.

        Raises
        ------
        ValueError
            If there is no such file, or it is damaged or something else.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                unpacked = sum(part.file_size for part in file.zip.infolist())
                if unpacked > _LARGEST_FILE:
                    raise ValueError(f"it unpacks to {unpacked} bytes")
                if str(file["format"]) != _FORMAT:
                    raise ValueError(f"its format is {str(file['format'])!r}, not {_FORMAT!r}")
                return cls(
                    file["scales"],
                    file["kernels"],
                    max_scale=float(file["max_scale"]),
                    provenance=json.loads(str(file["provenance"])),
                )
        except FileNotFoundError:
            raise ValueError(f"cannot read {path}: there is no such file") from None
        # Damaged bytes lead zipfile, zlib and numpy into whatever they raise.
        except Exception as error:
            raise ValueError(
                f"cannot read {path}: it is not a measured PSF, or it is damaged ({error})"
            ) from error


def _checked_scales(scales: ArrayLike) -> NDArray[np.float64]:
    array = real_array(scales, "scales are")
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"scales have shape {array.shape}; it takes (M,), M from 1 up")
    increasing = array[0] >= 0 and (np.diff(array) > 0).all() and array[-1] > 0
    if not (np.isfinite(array).all() and increasing):
        raise ValueError(f"scales are {array.tolist()}; it takes increasing px from 0 up")
    return array


def _checked_provenance(provenance: Mapping[str, Any] | None) -> dict[str, Any]:
    if provenance is None:
        return {}
    if not isinstance(provenance, Mapping):
        raise TypeError(f"provenance is {provenance!r}; it takes a dict, or None")
    try:
        return json.loads(json.dumps(dict(provenance)))
    except (TypeError, ValueError) as error:
        raise TypeError(f"provenance does not fit into JSON: {error}") from None


def _trimmed(kernel: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cut dark borders off, the same on all sides, and normalise to sum 1."""
    rows, columns = np.nonzero(kernel > _INVISIBLE * kernel.max())
    middle = len(kernel) // 2
    reach = max(np.abs(rows - middle).max(), np.abs(columns - middle).max())
    inner = slice(middle - reach, middle + reach + 1)
    return kernel[inner, inner] / kernel[inner, inner].sum()
