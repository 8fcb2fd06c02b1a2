"""What each plane of a stack shows of every size of detail, noted when it is read.

For each level of a Laplacian pyramid, these are the energy of the details around each place, and
how much light there is. Both are smooth, so they are kept at half the size of the level: less than
three bytes a pixel and plane. It is noted, too, where some plane is as bright as any gets, over a
few pixels: light is clipped there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, gaussian_filter, maximum_filter

from napari_defocus.stacks.pyramids import details_of, halved, levels_for

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

AREA = 1.5
"""px of a level: standard deviation of the Gaussian that averages energy and light. By hand."""

_LEFT = math.sqrt(AREA**2 - 1) / 2
"""What is left of it at half the size: halving averages over a standard deviation of 1 px."""

_NEARLY, _FEWEST = 0.01, 3
"""How far below the brightest pixel clipped ones may be, as a share of the range: JPEG and splines
leave ripples. And the side of the least square of such pixels. Chosen by hand.
"""

_REACH = 4
"""px of a level: so near to clipped light, details are not taken for contrast. Of 0, 2, 4 and 8 px,
4 is best: 43.5, 48.0, 48.7 and 48.3 dB beside simulated highlights.
"""


class ShownDetail:
    """What planes show, level by level.

    Attributes
    ----------
    energy, light : list of (Z, h, w) float32 ndarray
        At half the size of each level: of the details around each place, and of the luminance.
    """

    def __init__(self, shape: tuple[int, ...], planes: int) -> None:
        self.energy: list[Float32] = []
        self.light: list[Float32] = []
        side = np.array(shape[:2])
        for _ in range(levels_for(shape)):
            side = -(-side // 2)
            self.energy.append(np.empty((planes, *side), np.float32))
            self.light.append(np.empty((planes, *side), np.float32))
        self._brightest = np.full(shape[:2], -np.inf, np.float32)
        self._darkest = np.inf
        self._range = [np.inf, -np.inf]

    def __len__(self) -> int:
        """Count the levels."""
        return len(self.energy)

    def see(self, number: int, luminance: Float32, brightest: Float32) -> None:
        """Look at a plane.

        Parameters
        ----------
        number : int
        luminance : (H, W) float32 ndarray
        brightest : (H, W) float32 ndarray
            The brightest colour of each pixel, as the camera gave it.
        """
        picture = luminance[..., None]
        for level, (energy, light) in enumerate(zip(self.energy, self.light, strict=True)):
            small = halved(picture)
            details = details_of(picture, small) if level < len(self) - 1 else picture
            energy[number] = gaussian_filter(halved(details**2)[..., 0], _LEFT)
            light[number] = gaussian_filter(small[..., 0], _LEFT)
            picture = small
        np.maximum(self._brightest, brightest, out=self._brightest)
        self._darkest = min(self._darkest, float(brightest.min()))
        low, high = self._range
        self._range = [min(low, float(luminance.min())), max(high, float(luminance.max()))]

    @property
    def range(self) -> float:
        """How far the luminance of the planes reaches."""
        return self._range[1] - self._range[0]

    def near_clipped(self) -> list[Mask]:
        """Return which pixels of each level are near clipped light."""
        brightest = float(self._brightest.max())
        least = brightest - _NEARLY * (brightest - self._darkest)
        clipped = np.zeros(self._brightest.shape, bool)
        if self._darkest < brightest:
            clipped = binary_opening(self._brightest >= least, np.ones((_FEWEST, _FEWEST), bool))
        found = []
        for _ in range(len(self)):
            found.append(maximum_filter(clipped, 2 * _REACH + 1) if clipped.any() else clipped)
            clipped = maximum_filter(clipped, 3)[::2, ::2]
        return found
