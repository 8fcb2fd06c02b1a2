"""Maps, masks and confidences have the same bits whatever computes them.

What is promised exact (parts of a picture, any number of workers, a batch that is killed and
started again) must not depend on the kernels of a library of linear algebra, on the number of
threads, or on whether numba compiled a kernel in this process or read it from its cache.
"""

import ast
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import napari_defocus
from napari_defocus.core.threads import in_bands, in_order

PACKAGE = Path(napari_defocus.__file__).parent

SCENE = """
import hashlib
import numpy as np
from skimage.data import camera
from napari_defocus import *

def show(**found):
    for name, values in found.items():
        print(name, hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest())

picture = np.repeat(camera()[40:170, 150:310, None], 3, axis=2) / 255
picture[..., 1] **= 1.2
radius = np.broadcast_to(np.linspace(0.5, 6, 160), (130, 160))
seen = simulate_defocus(picture, radius, noise_variance=1e-5, rng=0)
candidates = estimate_candidates(seen)
blur_map = label_blur_map(candidates, seen)
confidence = confidence_map(candidates, blur_map)
mask = segment_in_focus(candidates, seen)
show(candidates=candidates.radii, curves=candidates.curve, mask=mask)
show(blur_map=blur_map, confidence=confidence)
"""

RESULTS = """
safe = cautious_blur_map(candidates, blur_map)
kernels = np.stack([np.pad(Disc().kernel(1), 3), Disc().kernel(4)])
corner = seen[:60, :60]
show(
    all_in_focus=restore_all_in_focus(seen, safe, confidence=confidence),
    of_wide_blur=restore_all_in_focus(seen, 3 * radius),
    measured_lens=estimate_candidates(corner, psf=MeasuredPSF([1, 4], kernels)).curve,
    other_family=estimate_candidates(corner, psf=GeneralizedGaussian(4.0, 3.0)).curve,
)
"""

COMPILED_BEFORE = """
from numba.core import event
from napari_defocus.compilation import compile_kernels

class Late(event.Listener):
    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        module = function.__module__
        if module.startswith("napari_defocus") and not module.endswith("blur_operator"):
            print("compiled late:", function.__name__)

    def on_end(self, event):
        pass

class Strings(Late):
    def on_start(self, event):
        if event.data["dispatcher"].py_func.__module__ == "numba.cpython.unicode":
            print("compiled for a message that cannot be: see core/compiled.py")

event.register("numba:compile", Strings())
steps = []
compile_kernels(lambda step, done: steps.append(step))
assert steps and all(step.startswith("Compiling the program, once (") for step in steps), steps
again = len(steps)
compile_kernels(lambda step, done: steps.append(step))
assert len(steps) == again
event.register("numba:compile", Late())
"""
"""Ends in an error if not all that is compiled is reported, and prints what is compiled later.

And that strings are compiled: they take seconds, and no kernel needs any.
"""

SIGNATURES = """
import sys
from numba.core.dispatcher import Dispatcher
for name, module in sorted(sys.modules.items()):
    if name.startswith("napari_defocus."):
        for kernel in vars(module).values():
            inlined = isinstance(kernel, Dispatcher) and kernel.targetoptions.get("forceinline")
            if isinstance(kernel, Dispatcher) and len(kernel.signatures) > 1 and not inlined:
                print(name, kernel.py_func.__name__, kernel.signatures)
"""

NEEDS = {"Nehalem": "SSE42", "Haswell": "AVX2", "SkylakeX": "AVX512F"}
"""The kernels of OpenBLAS that are tried, and what a processor must have for them."""


def can_run(kernels):
    from numpy._core._multiarray_umath import __cpu_features__

    return __cpu_features__.get(NEEDS[kernels], False) or (
        NEEDS[kernels] == "SSE42" and __cpu_features__.get("X86_V2", False)
    )


def results_with(threads, kernels=None, script=SCENE + RESULTS, **more):
    environment = os.environ | {"OPENBLAS_NUM_THREADS": threads, "NUMBA_NUM_THREADS": threads}
    environment |= more
    environment.pop("OPENBLAS_CORETYPE", None)
    if kernels is not None:
        environment["OPENBLAS_CORETYPE"] = kernels
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Where these tests keep compiled kernels: they need none of other tests, and wait for none."""
    return {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("numba"))}


@pytest.fixture(scope="module")
def just_compiled(cache):
    return results_with("2", script=COMPILED_BEFORE + SCENE, **cache)


@pytest.fixture(scope="module")
def usual(just_compiled, cache):
    """Results of compiled kernels, and which of these have several signatures."""
    # Too large a radius is reduced on the way.
    known = "confidence=np.ones(radius.shape), noise_variance=np.float64(1e-5)"
    restored = f"restore_all_in_focus(seen, 0 * radius + 7.5, {known})"
    script = SCENE + RESULTS + "print('signatures')\n" + restored + SIGNATURES
    return results_with("1", script=script, **cache).partition("signatures\n")[::2]


@pytest.mark.parametrize(
    ("kernels", "threads"), [("Nehalem", "2"), ("Haswell", "1"), ("SkylakeX", "2")]
)
def test_results_do_not_depend_on_linear_algebra_or_threads(usual, cache, kernels, threads):
    if not can_run(kernels):
        pytest.skip(f"this processor has no {NEEDS[kernels]}")
    assert results_with(threads, kernels, **cache) == usual[0]


def test_kernels_compiled_before_the_first_map_are_all_and_give_what_cached_ones_give(
    just_compiled, usual
):
    assert just_compiled.startswith("candidates")
    assert usual[0].startswith(just_compiled)


def test_each_kernel_has_one_signature(usual):
    # So two processes that compile at once put the same files into numba's cache.
    assert usual[1].count("(") == 0


def test_no_kernel_lets_the_compiler_reorder_sums():
    options = {
        keyword.arg: path.name
        for path in PACKAGE.rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(call, ast.Call) and "jit" in ast.unparse(call.func)
        for keyword in call.keywords
    }
    assert "nogil" in options
    assert options.keys() & {"fastmath", "parallel"} == set()


@pytest.mark.parametrize("length", [0, 1, 7, 100])
@pytest.mark.parametrize("least", [1, 16])
def test_bands_cover_every_row_once(length, least):
    counts = np.zeros(length, int)

    def count(start, stop, counts):
        assert start % least == 0
        counts[start:stop] += 1

    in_bands(count, length, counts, least=least)
    assert (counts == 1).all()


def test_error_in_a_band_is_raised():
    def fail(start, stop):
        raise MemoryError("no room")

    with pytest.raises(MemoryError, match="no room"):
        in_bands(fail, 100)


def test_results_come_in_the_order_of_the_items():
    def slow_first(item):
        time.sleep(0.05 * (item == 0))
        return item

    assert list(in_order(slow_first, range(9))) == list(range(9))


def test_error_of_one_item_is_raised_in_its_place():
    found = in_order(lambda item: 6 // item, [2, 1, 0, 3])
    assert [next(found), next(found)] == [3, 6]
    with pytest.raises(ZeroDivisionError):
        next(found)
