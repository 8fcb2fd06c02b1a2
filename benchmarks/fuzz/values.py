"""Odd values for run.py: pictures of every dtype and memory layout, and wrong arguments.

All functions take a `random.Random`: that of a seed, or one that hypothesis steers.
"""

import datetime
import fractions
import pathlib
from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

INTEGERS = ("u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8")
FLOATS = ("f2", "f4", "f8", "g")
SIDES = (3, 4, 5, 7, 12, 16, 17, 31, 40, 41, 42, 48, 64)


def texture(rnd: Random, shape: tuple[int, ...]) -> np.ndarray:
    """Return intensities in [0, 1] of one of the kinds that pictures are of."""
    rng = np.random.default_rng(rnd.getrandbits(32))
    kind = rnd.choice(["noise", "clouds", "constant", "black", "ramp", "step", "dots", "saturated"])
    if kind == "noise":
        return rng.random(shape)
    if kind == "clouds":
        sigma = (rnd.choice([0.5, 2.0, 8.0]),) * 2 + (0,) * (len(shape) - 2)
        soft = gaussian_filter(rng.standard_normal(shape), sigma)
        return np.clip(0.5 + 0.2 * soft / (soft.std() + 1e-12), 0, 1)
    if kind in ("constant", "black"):
        return np.full(shape, 0.0 if kind == "black" else rng.random())
    if kind == "ramp":
        ramp = np.linspace(0, 1, shape[1])
        return np.broadcast_to(ramp.reshape(-1, *(1,) * (len(shape) - 2)), shape)
    if kind == "step":
        return (np.indices(shape)[1] >= shape[1] // 2).astype(float)
    return (rng.random(shape) < (0.02 if kind == "dots" else 0.98)).astype(float)


def typed(rnd: Random, values: np.ndarray) -> np.ndarray:
    """Return intensities in [0, 1] as one of NumPy's real dtypes, of either byte order."""
    kind = rnd.choice(["?", *INTEGERS, *FLOATS, "f4", "f8", "u1", "u2"])
    if kind == "?":
        array = values > 0.5
    elif kind in INTEGERS:
        limits = np.iinfo(kind)
        array = np.clip(values * float(limits.max), 0, np.nextafter(float(limits.max), 0))
        array = array.astype(kind)
    else:
        array = values.astype(kind)
    return array.astype(array.dtype.newbyteorder(rnd.choice("=><")))


def laid_out(rnd: Random, array: np.ndarray) -> Any:
    """Return the same values in one of the ways in which memory can hold them."""
    ways: list[Callable[[np.ndarray], Any]] = [
        lambda a: a,
        np.asfortranarray,
        lambda a: np.flip(np.flip(a).copy()),
        lambda a: np.repeat(a, 2, axis=-1)[..., ::2],
        lambda a: np.pad(a, [(1, 2)] * a.ndim)[(slice(1, -2),) * a.ndim],
        locked,
        misaligned,
        lambda a: np.ma.array(a),
        lambda a: a.tolist() if a.size < 5000 and a.dtype.kind == "f" else a,
        lambda a: Given(a),
        lambda a: a.view(np.recarray) if a.dtype.kind in "uif" else a,
    ]
    return rnd.choice(ways)(array)


def locked(array: np.ndarray) -> np.ndarray:
    copy = array.copy()
    copy.setflags(write=False)
    return copy


def misaligned(array: np.ndarray) -> np.ndarray:
    """Return a copy that begins at an odd address."""
    memory = np.zeros(array.nbytes + 1, np.uint8)
    copy = memory[1:].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


class Given:
    """What is an array only if it is asked for one."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.array if dtype is None else self.array.astype(dtype)


def odd_picture(rnd: Random) -> Any:
    """Return what may or may not be a picture."""
    grey = texture(rnd, (rnd.choice(SIDES), rnd.choice(SIDES)))
    odd: list[Callable[[], Any]] = [
        lambda: np.zeros(rnd.choice([(0, 5), (5, 0), (0,), (), (1, 1), (2, 9), (9, 1), (5, 5, 5)])),
        lambda: np.zeros((2, 3, 4, 9, 9)[: rnd.randrange(6)]),
        lambda: grey * rnd.choice([1e300, 1e38, 1e-300, 5e-324, 1e-40, -1, 255, 65535, 1e6]),
        lambda: grey + rnd.choice([1e6, 1e15, -1e6, np.nan, np.inf]),
        lambda: np.where(grey > np.median(grey), rnd.choice([np.nan, np.inf, -np.inf]), grey),
        lambda: grey.astype(complex),
        lambda: grey.astype(object),
        lambda: grey.astype(str),
        lambda: grey.astype("S5"),
        lambda: np.zeros(grey.shape, [("a", "f4"), ("b", "u1")]),
        lambda: np.zeros(grey.shape, rnd.choice(["M8[s]", "m8[ms]", "V3"])),
        lambda: np.ma.array(grey, mask=grey > 0.4),
        lambda: np.ma.masked_all(grey.shape),
        lambda: np.broadcast_to(rnd.choice([0.5, np.float32(0.1), 7, True]), grey.shape),
        lambda: np.broadcast_to(grey[:1], grey.shape),
        lambda: np.asmatrix(grey),
        lambda: [[1, 2, 3], [4, 5]],
        lambda: texture(rnd, (3, rnd.choice([100, 900]))),
        lambda: texture(rnd, (rnd.choice([100, 900]), 3)),
        lambda: np.dstack([grey] * rnd.choice([1, 2, 3, 4, 5])),
        lambda: np.dstack([grey, grey, grey, np.zeros_like(grey)]),
        lambda: lazy(rnd, grey),
    ]
    return rnd.choice(odd)()


def lazy(rnd: Random, array: np.ndarray) -> Any:
    """Return a dask array of odd chunks."""
    import dask.array as da

    def chunks_of(side: int) -> tuple[int, ...]:
        cut = rnd.randint(1, side)
        return (cut, side - cut) if cut < side else (side,)

    return da.from_array(array, chunks=tuple(chunks_of(n) if n else (0,) for n in array.shape))


def anything(rnd: Random) -> Any:
    """Return what is, most probably, no value of the argument."""
    values: list[Callable[[], Any]] = [
        lambda: rnd.choice([None, True, False, -1, 0, 1, 2, 3, 4, 7, 1000, 10**30, -(10**30)]),
        lambda: rnd.choice([0.0, -0.0, 0.5, -0.5, 3.5, 1e300, -1e300, 5e-324, 1e-12]),
        lambda: rnd.choice([float("nan"), float("inf"), -float("inf"), 1j, complex("nan")]),
        lambda: rnd.choice(["", "disc", "4", "far", "yx", "\0", "ü" * 300, b"srgb", "nan"]),
        lambda: rnd.choice([[], (), {}, set(), [1, 2], (0, 1), (1.0, 0.0), [None], {"a": 1}]),
        lambda: rnd.choice([object(), int, lambda x: x, range(3), NotImplemented, ...]),
        lambda: rnd.choice([np.float32(2), np.int8(-1), np.bool_(True), np.str_("a"), np.nan]),
        lambda: rnd.choice([np.array(3), np.array(2.5), np.array([1, 2]), np.array("x")]),
        lambda: rnd.choice([fractions.Fraction(1, 2), datetime.date(2000, 1, 1)]),
        lambda: rnd.choice([pathlib.Path("none.png"), np.datetime64("2000"), np.ma.masked]),
        lambda: iter([1, 2]),
        lambda: np.random.default_rng(0),
        lambda: odd_picture(rnd),
    ]
    return rnd.choice(values)()


def picture(rnd: Random, shape: tuple[int, int] | None = None) -> Any:
    """Return a picture that every function takes: grey, colours, colours and opacity."""
    height, width = shape or (rnd.choice(SIDES), rnd.choice(SIDES))
    channels = rnd.choice([(), (), (3,), (4,)])
    return laid_out(rnd, typed(rnd, texture(rnd, (height, width, *channels))))


def shape_of(image: Any) -> tuple[int, ...]:
    return tuple(np.shape(image.array if isinstance(image, Given) else image))
