"""A lens measured from image layers, and saved: no Qt, any thread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from napari.layers import Image
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.core.writing import NeedsForce, check_results
from napari_defocus.widgets.layers.image_layers import (
    NotAnalysableError,
    Plane,
    plane_at,
    unwrapped,
)
from napari_defocus.widgets.layers.result_layers import kernels_layer

if TYPE_CHECKING:
    from typing import Any

    from napari_defocus import MeasuredPSF

_READING_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a lens is measured from.

    Attributes
    ----------
    planes : sequence of Plane
        One for each setting of the focus.
    sharp : sequence of Plane
        None: the planes show point sources; one: the same in focus; or one for each plane.
    scales : sequence of float, optional
        Scale of each plane in px; measured if left out.
    file : Path
        Where the lens is saved (.npz).
    overwrite : bool
        Whether a file that exists is replaced.
    """

    planes: Sequence[Plane]
    sharp: Sequence[Plane] = ()
    scales: Sequence[float] | None = None
    file: Path
    overwrite: bool = False

    def __post_init__(self) -> None:
        """Refuse, before any work is done, what cannot be."""
        if len(self.planes) < 2:
            raise ValueError(
                "A lens is measured from two pictures or more, each at another setting of the "
                "focus. Select their layers in the layer list, or one layer that is a stack."
            )
        if self.scales is not None and len(self.scales) != len(self.planes):
            raise ValueError(
                f"There are {len(self.scales)} scales for {len(self.planes)} pictures. Type one "
                f"for each, or none to have them measured."
            )
        if len(self.sharp) not in (0, 1, len(self.planes)):
            raise ValueError(
                f"There are {len(self.sharp)} sharp pictures for {len(self.planes)} blurred "
                f"ones. Choose one for all, or a stack with one for each."
            )
        self._check_file()

    def _check_file(self) -> None:
        if self.file.suffix.lower() != ".npz":
            raise ValueError("Choose a file to save the lens in; its name must end in .npz.")
        try:
            check_results([self.file], force=self.overwrite)
        except NeedsForce as error:
            raise ValueError(error.told("a tick at “overwrite”")) from None
        except OSError as error:
            raise ValueError(str(error)) from None

    def run(self, progress: Progress = silent) -> list[LayerDataTuple]:
        """Measure the lens, save it, and return the layer of its kernels.

        Raises
        ------
        ValueError
            If no lens can be measured from the pictures, or it cannot be saved.
        """
        pictures = [plane.read() for plane in self.planes]
        references = [plane.read() for plane in self.sharp]
        progress("Reading the pictures", _READING_SHARE)
        lens = self._measured(pictures, references, within(progress, _READING_SHARE, 1.0))
        try:
            self._check_file()
            lens.save(self.file)
        except OSError as error:
            raise ValueError(str(error)) from None
        return [kernels_layer(lens, str(self.file), self.planes[0])]

    def _measured(
        self,
        pictures: list[NDArray[Any]],
        references: list[NDArray[Any]],
        progress: Progress,
    ) -> MeasuredPSF:
        from napari_defocus import calibrate_psf

        names = _names(self.planes)
        try:
            return calibrate_psf(
                pictures,
                scales=self.scales,
                sharp=references[0] if len(references) == 1 else references or None,
                names=names,
                progress=progress,
            )
        except (TypeError, ValueError) as error:
            message = str(error)
            for index, name in enumerate(names):
                message = message.replace(f"pictures[{index}]", f"“{name}”")
            raise ValueError(message) from None


def planes_of(layer: Image) -> list[Plane]:
    """Return a picture as one plane, and a stack as all its planes along the first axis.

    Raises
    ------
    NotAnalysableError
        If the layer has more axes.
    """
    layer = unwrapped(layer)
    both = slice(None), slice(None)
    if layer.ndim == 2:
        return [plane_at(layer, both)]
    if layer.ndim == 3:
        count = (layer.data[0] if layer.multiscale else layer.data).shape[0]
        return [plane_at(layer, (index, *both)) for index in range(count)]
    raise NotAnalysableError(
        f"“{layer.name}” has {layer.ndim} axes; pictures and stacks of pictures are taken."
    )


def numbers(text: str) -> list[float] | None:
    """Return the numbers of a text with commas or blanks between, None if it has none.

    Raises
    ------
    ValueError
        If something in it is no number.
    """
    try:
        return [float(part) for part in text.replace(",", " ").split()] or None
    except ValueError:
        raise ValueError(
            f"The scales are “{text}”. Type numbers with commas between, such as 1, 2.5, 4, or "
            f"nothing to have them measured."
        ) from None


def _names(planes: Sequence[Plane]) -> list[str]:
    """Return the name of each plane's layer, with the number of the plane in a stack."""
    return [
        plane.name if len(plane.index) == 2 else f"{plane.name} {plane.index[0]}"
        for plane in planes
    ]
