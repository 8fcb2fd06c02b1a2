"""The kernels of a map are compiled before the first one, and it is told; once a machine.

numba compiles a kernel when it is first called, and keeps it on the disk. On a new machine that is
most of the time of the first map. So a tiny picture is measured first, and each kernel that is
compiled meanwhile, instead of being read from the disk, is reported.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numba.core import event
from numba.core.dispatcher import Dispatcher
from scipy.ndimage import gaussian_filter

from napari_defocus.core.progress import COMPILING, Progress
from napari_defocus.core.threads import in_one_thread
from napari_defocus.labeling import (
    confidence,
    continuous_refinement,
    data_term,
    fusions,
    graph_cuts,
    minimum_cuts,
    multigrid,
    pairwise_term,
    pixel_refinement,
)
from napari_defocus.labeling.blur_map import labeled_blur_map
from napari_defocus.labeling.confidence import map_confidence
from napari_defocus.labeling.data_term import Costs, least_of_both
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.labeling.segmentation import labeled_mask
from napari_defocus.likelihood import evidence, gabor, maxima, profile_likelihood, scale_space
from napari_defocus.likelihood.estimation import Estimation
from napari_defocus.psf.families import Disc

_MODULES = (
    *(gabor, profile_likelihood, maxima, evidence, scale_space, data_term, multigrid),
    *(
        graph_cuts,
        fusions,
        minimum_cuts,
        pairwise_term,
        pixel_refinement,
        continuous_refinement,
        confidence,
    ),
)
"""Where the kernels of maps, masks and confidences are."""

_SIDE = 168
"""px: enough for two levels of averaged pixels, and for a coarser grid of labels."""

_turn = threading.Lock()
_compiled = False


def compile_kernels(progress: Progress) -> None:
    """Compile all kernels of maps, masks and confidences, or read them from numba's cache.

    Nothing is done, and nothing reported, after the first call in a process.

    Parameters
    ----------
    progress : callable
        Called in this thread before each kernel that is compiled, as
        ``progress("Compiling the program, once (3 of 20)", 0.0)``. An exception from it ends the
        compilation; what was compiled is kept.
    """
    global _compiled
    with _turn:
        if not _compiled:
            with in_one_thread(), _reports(progress):
                _measure_something()
            _compiled = True


def _measure_something() -> None:
    """Measure a picture that is sharp on one side of an edge: all kernels have something to do."""
    sharp = np.random.default_rng(0).random((_SIDE, _SIDE, 3), np.float32)
    blurred = (9 * gaussian_filter(sharp, (3, 3, 0)) - 4).astype(np.float32)
    picture = np.where(np.arange(_SIDE)[:, None] < _SIDE // 2, sharp, blurred)
    how = Estimation(Disc(), stride=2)
    candidates = how.candidates(how.prepared(picture), 1e-5)
    problem = LabelingProblem.of(candidates, picture)
    map_confidence(candidates, labeled_blur_map(problem))
    labeled_mask(problem)
    _use_costs(Costs.of(problem.own))


def _use_costs(costs: Costs) -> None:
    """Do what is done with costs of a large picture alone."""
    low = np.zeros(costs.shape[:2], np.int32)
    some = low, low + np.int32(1), np.arange(2)
    costs.change(*some)
    costs.change_between(*some, *(np.arange(length, dtype=float) for length in low.shape))
    least_of_both(costs, 1)


@contextmanager
def _reports(progress: Progress) -> Iterator[None]:
    kernels = {
        value.py_func
        for module in _MODULES
        for value in vars(module).values()
        if isinstance(value, Dispatcher)
    }
    listener = _Compilations(kernels, progress)
    with event.install_listener("numba:compile", listener):
        yield


class _Compilations(event.Listener):
    """Reports which of some kernels is being compiled in the thread that listens."""

    def __init__(self, kernels: set[Any], progress: Progress) -> None:
        self._left, self._total = kernels, len(kernels)
        self._progress = progress
        self._thread = threading.get_ident()

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"].py_func
        if kernel in self._left and threading.get_ident() == self._thread:
            self._left.discard(kernel)
            number = self._total - len(self._left)
            self._progress(f"{COMPILING} the program, once ({number} of {self._total})", 0.0)

    def on_end(self, event: Any) -> None:
        pass
