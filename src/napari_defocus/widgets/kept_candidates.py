"""Candidates kept between runs, so that segmenting again need not estimate again."""

from __future__ import annotations

import hashlib
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any

from napari.layers import Image
from numpy.typing import NDArray

if TYPE_CHECKING:
    from napari_defocus import BlurCandidates


class KeptCandidates:
    """The candidates of the last few layers, one set a layer.

    They are looked up by the pixels themselves: an edited picture, in place or not, is
    another picture. A layer that is deleted takes its candidates with it.

    Parameters
    ----------
    layers : int
        How many layers to keep candidates of; the one not used for longest goes first.
    """

    def __init__(self, layers: int = 3) -> None:
        self._layers = layers
        self._kept: OrderedDict[weakref.ref[Image], tuple[Hashable, BlurCandidates]] = OrderedDict()
        # Runs of several widgets look up from their own threads.
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._kept)

    def get(
        self,
        layer: weakref.ref[Image],
        key: Hashable,
        estimate: Callable[[], BlurCandidates],
    ) -> BlurCandidates:
        """Return the candidates of a layer: the kept ones if `key` is theirs, else new ones.

        Parameters
        ----------
        layer : weak reference to napari.layers.Image
        key : hashable
            Everything that the candidates depend on.
        estimate : callable
            Makes them, if they must be made.
        """
        candidates = self._kept_for(layer(), key)
        if candidates is None:
            candidates = estimate()
            self._keep(layer(), key, candidates)
        return candidates

    def _kept_for(self, layer: Image | None, key: Hashable) -> BlurCandidates | None:
        if layer is None:
            return None
        with self._lock:
            kept_key, candidates = self._kept.get(weakref.ref(layer), (None, None))
            if kept_key != key:
                return None
            self._kept.move_to_end(weakref.ref(layer))
            return candidates

    def _keep(self, layer: Image | None, key: Hashable, candidates: BlurCandidates) -> None:
        if layer is None:
            return
        with self._lock:
            kept = weakref.ref(layer, self._drop)
            self._kept[kept] = (key, candidates)
            self._kept.move_to_end(kept)
            while len(self._kept) > self._layers:
                self._kept.popitem(last=False)

    def _drop(self, layer: weakref.ref[Image]) -> None:
        with self._lock:
            self._kept.pop(layer, None)


def fingerprint(image: NDArray[Any]) -> str:
    """Return a digest of a picture's shape, dtype and pixels."""
    digest = hashlib.blake2b(repr((image.shape, image.dtype.str)).encode(), digest_size=16)
    digest.update(image.data)
    return digest.hexdigest()
