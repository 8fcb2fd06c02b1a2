import os
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from skimage import data

from napari_defocus import simulate_defocus

# Threads of kernels that wait for others sleep instead of turning in circles: pictures are small
# here, and cores may be shared. OpenMP reads it when the first kernel starts.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")


HERE = Path(__file__).parent


@lru_cache
def opens_windows(file):
    return "pytest.mark.display" in file.read_text("utf-8")


def pytest_collection_modifyitems(config, items):
    """Begin with the tests that open windows, if processes share the tests.

    They are 2/5 of the time, and compile what maps need. Beside them begin those that compile for
    themselves, then the other files here, which are few and long: no process is to work on one
    when the other has no more to do.
    """
    if config.getoption("dist", "no") != "no" or hasattr(config, "workerinput"):
        items.sort(
            key=lambda item: (
                not opens_windows(item.path),
                item.path.name != "test_same_bits.py",
                item.path.parent != HERE,
            )
        )


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Let processes share the tests: those of a file go together, and all that open windows.

    `--dist loadgroup` has no groups with pytest 9.2: xdist 3.8 puts them into names of tests that
    pytest does not read any more. Each process then makes what the tests of a file share.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Files(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return "windows" if opens_windows(config.rootpath / file) else file

    return Files(config, log)


@pytest.fixture(scope="session", autouse=True)
def _every_kernel_is_compiled_once(request, tmp_path_factory):
    """Of the processes that share the tests, one compiles a kernel; the others wait and load it.

    No two wait for each other: a kernel waits for those that it calls, and none calls itself.
    """
    if not hasattr(request.config, "workerinput"):
        yield
        return
    locks = tmp_path_factory.getbasetemp().parent / "kernels"
    locks.mkdir(exist_ok=True)
    compiled = Dispatcher.compile

    def compiled_in_turn(kernel, signature):
        of = kernel.py_func
        if not of.__module__.startswith("napari_defocus"):
            return compiled(kernel, signature)
        lock = FileLock(locks / f"{of.__module__}.{of.__qualname__}", is_singleton=True)
        # In this order: a thread that compiles must not wait for one that waits to compile.
        with global_compiler_lock, lock:
            return compiled(kernel, signature)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Dispatcher, "compile", compiled_in_turn)
        yield


def _locked(picture):
    picture.setflags(write=False)
    return picture


def _half_size(name, side):
    """A picture as sharp as its pixels: camera pictures are not at their full size."""
    picture = getattr(data, name)()[: 2 * side, : 2 * side] / 255.0
    halves = picture.reshape(side, 2, side, 2, -1).mean(axis=(1, 3))
    return _locked(halves.squeeze().astype(np.float32))


@pytest.fixture(scope="session")
def grass():
    """Grey texture everywhere: (160, 160), [0, 1]."""
    return _half_size("grass", 160)


@pytest.fixture(scope="session")
def gravel():
    """Grey texture everywhere: (160, 160), [0, 1]."""
    return _half_size("gravel", 160)


@pytest.fixture(scope="session")
def astronaut():
    """A portrait in colour, with flat places: (160, 160, 3), [0, 1]."""
    return _half_size("astronaut", 160)


@pytest.fixture(scope="session")
def clouds():
    """Noise with amplitudes falling as 1 / frequency, as in pictures: (160, 160), sharp."""
    side = 256
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side))
    frequency[0, 0] = 1
    white = np.random.default_rng(1).standard_normal((side, side))
    fractal = np.fft.ifft2(np.fft.fft2(white) / frequency).real
    fractal = 0.5 + 0.15 * (fractal - fractal.mean()) / fractal.std()
    return _locked(fractal[:160, :160].astype(np.float32))


@pytest.fixture(scope="session")
def defocused():
    """Blur a picture by a radius or a map of radii in px, with a little noise."""

    def blur(picture, radius, noise_variance=1e-6, rng=0):
        radii = np.broadcast_to(np.asarray(radius, float), picture.shape[:2])
        return simulate_defocus(picture, radii, noise_variance=noise_variance, rng=rng)

    return blur


@pytest.fixture(scope="session")
def ramp():
    """Radii from 2 to 4 px, left to right, over 160 px: 1 px in 80."""
    return np.broadcast_to(np.linspace(2, 4, 160), (160, 160))


@pytest.fixture(scope="session")
def ramp_picture(clouds, ramp, defocused):
    return _locked(defocused(clouds, ramp))


@pytest.fixture(scope="session")
def scene(grass, gravel, defocused):
    """A warm disc before something cool, one of them blurred by 5 px.

    Returns the picture, (360, 360, 3), and where the disc is.
    """

    def build(blurred, radius=85):
        row, column = np.indices((360, 360)) - 179.5
        inside = row**2 + column**2 < radius**2
        layers = {"subject": (grass, (0.7, 0.45, 0.2)), "background": (gravel, (0.2, 0.35, 0.6))}
        seen = {}
        for layer, (texture, color) in layers.items():
            large = np.pad(texture - texture.mean(), 100, mode="symmetric")
            large = 0.5 * large[..., None] + np.array(color)
            seen[layer] = defocused(large, 5, 0) if layer == blurred else large
        picture = np.where(inside[..., None], seen["subject"], seen["background"])
        noise = np.random.default_rng(0).normal(0, 1e-3, picture.shape)
        return (picture + noise).astype(np.float32), inside

    return build
