"""What was found is kept between runs: segmenting again need not estimate again."""

from __future__ import annotations

import hashlib
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from napari.layers import Image
from numpy.typing import NDArray

if TYPE_CHECKING:
    from napari_defocus.widgets.jobs.estimation import Analysed, EstimatedMap

T = TypeVar("T")


class Kept(Generic[T]):
    """What was found of the last few layers, one thing a layer.

    It is looked up by the pixels themselves: an edited picture, in place or not, is
    another picture. A layer that is deleted takes what was found with it.

    Parameters
    ----------
    layers : int
        How many layers to keep something of; the one not used for longest goes first.
    """

    def __init__(self, layers: int = 3) -> None:
        self._layers = layers
        self._kept: OrderedDict[weakref.ref[Image], tuple[Hashable, T]] = OrderedDict()
        # Runs of several widgets look up from their own threads.
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._kept)

    def get(
        self,
        layer: weakref.ref[Image],
        key: Hashable,
        find: Callable[[], T],
    ) -> T:
        """Return what was found of a layer if `key` is the same, else find it.

        Parameters
        ----------
        layer : weak reference to napari.layers.Image
        key : hashable
            Everything that it depends on.
        find : callable
            Finds it, if it must be found.
        """
        found = self.known(layer, key)
        if found is None:
            found = find()
            self.keep(layer(), key, found)
        return found

    def known(self, layer: weakref.ref[Image], key: Hashable) -> T | None:
        """Return what was found of a layer if `key` is the same, else None."""
        living = layer()
        if living is None:
            return None
        with self._lock:
            kept_key, found = self._kept.get(weakref.ref(living), (None, None))
            if kept_key != key:
                return None
            self._kept.move_to_end(weakref.ref(living))
            return found

    def latest(self, layer: Image) -> T | None:
        """Return what was found of a layer last, whatever of."""
        layer = getattr(layer, "__wrapped__", layer)
        with self._lock:
            _, found = self._kept.get(weakref.ref(layer), (None, None))
            return found

    def keep(self, layer: Image | None, key: Hashable, found: T) -> None:
        """Keep something of a layer, if it still lives, instead of what was kept of it."""
        if layer is None:
            return
        with self._lock:
            kept = weakref.ref(layer, self._drop)
            self._kept[kept] = (key, found)
            self._kept.move_to_end(kept)
            while len(self._kept) > self._layers:
                self._kept.popitem(last=False)

    def _drop(self, layer: weakref.ref[Image]) -> None:
        with self._lock:
            self._kept.pop(layer, None)


class KeptWork:
    """What all widgets have found, and use again: none does what another has done.

    Attributes
    ----------
    maps : Kept of EstimatedMap
    restored : Kept of float32 ndarray
        All-in-focus pictures.
    analysed : Kept of Analysed
        The candidates, and all else that is known of the plane that was analysed last.
    """

    def __init__(self) -> None:
        self.maps: Kept[EstimatedMap] = Kept()
        self.restored: Kept[NDArray[np.float32]] = Kept()
        self.analysed: Kept[Analysed] = Kept()


def fingerprint(image: NDArray[Any]) -> str:
    """Return a digest of an array's shape, dtype and values."""
    digest = hashlib.blake2b(repr((image.shape, image.dtype.str)).encode(), digest_size=16)
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()
