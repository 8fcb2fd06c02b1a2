"""What was found is kept between runs: segmenting again need not estimate again."""

from __future__ import annotations

import hashlib
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

import numpy as np
from napari.layers import Image
from numpy.typing import NDArray

from napari_defocus.widgets.layers.image_layers import unwrapped

T = TypeVar("T")


class LayerCache(Generic[T]):
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
        self._found: OrderedDict[weakref.ref[Image], tuple[Hashable, T]] = OrderedDict()
        # Runs of several widgets look up from their own threads.
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._found)

    def get(
        self,
        layer: weakref.ref[Image],
        key: Hashable,
        find: Callable[[], T],
    ) -> T:
        """Return what was found of a layer, else find it; the key is all that it depends on."""
        found = self.known(layer, key)
        if found is None:
            found = find()
            self.put(layer(), key, found)
        return found

    def known(self, layer: weakref.ref[Image], key: Hashable) -> T | None:
        """Return what was found of a layer if `key` is the same, else None."""
        living = layer()
        if living is None:
            return None
        with self._lock:
            its_key, found = self._found.get(weakref.ref(living), (None, None))
            if its_key != key:
                return None
            self._found.move_to_end(weakref.ref(living))
            return found

    def latest(self, layer: Image) -> T | None:
        """Return what was found of a layer last, whatever of."""
        layer = unwrapped(layer)
        with self._lock:
            _, found = self._found.get(weakref.ref(layer), (None, None))
            return found

    def put(self, layer: Image | None, key: Hashable, found: T) -> None:
        """Keep something of a layer, if it still lives, instead of what was there before."""
        if layer is None:
            return
        with self._lock:
            reference = weakref.ref(layer, self._drop)
            self._found[reference] = (key, found)
            self._found.move_to_end(reference)
            while len(self._found) > self._layers:
                self._found.popitem(last=False)

    def _drop(self, layer: weakref.ref[Image]) -> None:
        with self._lock:
            self._found.pop(layer, None)


def fingerprint(image: NDArray[Any]) -> str:
    """Return a digest of an array's shape, dtype and values."""
    digest = hashlib.blake2b(repr((image.shape, image.dtype.str)).encode(), digest_size=16)
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()
