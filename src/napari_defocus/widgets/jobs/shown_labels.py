"""Which labels of a picture are shown, and which of those that are wanted differ: no Qt."""

from dataclasses import replace
from typing import Any

from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.cache import fingerprint
from napari_defocus.widgets.jobs.estimation import Analysed


class ShownLabels:
    """What made the map and the mask that are shown."""

    def __init__(self) -> None:
        self._name = ""
        self._map: Any = None
        self._mask: Any = None

    def note(self, analysed: Analysed, analysis: Analysis, *, whole: bool = True) -> None:
        """Note that the labels of an analysis are shown now, or previews of them."""
        self._name = analysed.name
        if analysis.blur_map:
            self._map = _map_key(analysis) if whole else None
        if analysis.mask is not None:
            self._mask = _mask_key(analysis) if whole else None

    def changed(self, analysed: Analysed, analysis: Analysis) -> Analysis | None:
        """Return the part of an analysis whose labels are others; None if there is no such part.

        Neither is there one if nothing of this picture is shown.
        """
        if analysed.name != self._name:
            return None
        blur_map = analysis.blur_map and _map_key(analysis) != self._map
        mask = analysis.mask is not None and _mask_key(analysis) != self._mask
        if not (blur_map or mask):
            return None
        return replace(analysis, blur_map=blur_map, mask=analysis.mask if mask else None)


def _map_key(analysis: Analysis) -> tuple[Any, ...]:
    return analysis.estimation.smoothness, analysis.estimation.color_sigma


def _mask_key(analysis: Analysis) -> tuple[Any, ...]:
    seeds = analysis.seeds
    painted = seeds is not None and seeds.values.any()
    return analysis.mask, fingerprint(seeds.values) if seeds and painted else None
