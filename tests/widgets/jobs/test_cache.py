import gc
import weakref

import numpy as np
from napari.layers import Image

from napari_defocus.widgets.jobs.cache import LayerCache, fingerprint


class Estimate:
    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return f"candidates {self.calls}"


def an_image():
    return Image(np.zeros((8, 8)))


def test_same_layer_and_key_are_worked_on_once():
    cache, estimate, layer = LayerCache(), Estimate(), an_image()
    assert cache.get(weakref.ref(layer), "a", estimate) == "candidates 1"
    assert cache.get(weakref.ref(layer), "a", estimate) == "candidates 1"
    assert cache.get(weakref.ref(layer), "b", estimate) == "candidates 2"
    assert len(cache) == 1


def test_no_layer_gets_what_was_found_of_another():
    cache, estimate, layers = LayerCache(), Estimate(), [an_image(), an_image()]
    found = [cache.get(weakref.ref(layer), "a", estimate) for layer in layers]
    assert found == ["candidates 1", "candidates 2"]


def test_only_the_last_few_layers_are_kept():
    cache, estimate, layers = LayerCache(layers=2), Estimate(), [an_image() for _ in range(3)]
    for layer in (layers[0], layers[1], layers[0], layers[2]):
        cache.get(weakref.ref(layer), "a", estimate)
    assert (len(cache), estimate.calls) == (2, 3)
    cache.get(weakref.ref(layers[0]), "a", estimate)
    assert estimate.calls == 3


def test_deleted_layer_takes_what_was_found_with_it():
    cache, layer = LayerCache(), an_image()
    cache.get(weakref.ref(layer), "a", Estimate())
    del layer
    gc.collect()
    assert len(cache) == 0


def test_layer_that_is_gone_is_worked_on_but_not_kept():
    cache, layer = LayerCache(), an_image()
    gone = weakref.ref(layer)
    del layer
    gc.collect()
    assert cache.get(gone, "a", Estimate()) == "candidates 1"
    assert len(cache) == 0


def test_fingerprint_sees_one_changed_pixel_the_shape_and_the_dtype():
    image = np.zeros((6, 8), np.uint8)
    edited = image.copy()
    edited[3, 5] = 1
    prints = [fingerprint(a) for a in (image, edited, image.T.copy(), image.astype(bool))]
    assert len(set(prints)) == 4
    assert fingerprint(image.copy()) == prints[0]
