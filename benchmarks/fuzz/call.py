"""A random call: what goes in, and what must come out."""

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np

import napari_defocus as nd
from benchmarks.fuzz import values as odd


@dataclass
class Call:
    """A call of a public function: it returns what `check` is content with, or says why not.

    `fine` tells that nothing is wrong with any argument, so that an error would be one of ours.
    """

    function: Callable[..., Any]
    arguments: dict[str, Any]
    check: Callable[[Any, dict[str, Any]], None]
    fine: bool = True
    names: tuple[str, ...] = ()
    spoilt: list[str] = field(default_factory=list)

    def known_names(self) -> set[str]:
        """Return what a message may call the argument that it is about."""
        try:
            own = set(inspect.signature(self.function).parameters) - {"args", "kwargs"}
        except (TypeError, ValueError):
            own = set()
        return own | set(self.arguments) | set(self.names)


Recipe = Callable[[Random], Call]
RECIPES: dict[str, Recipe] = {}


def recipe(name: str) -> Callable[[Recipe], Recipe]:
    """Keep a recipe for calls of a public name, or of a method of one."""

    def keep(make: Recipe) -> Recipe:
        RECIPES[name] = make
        return make

    return keep


def random_call(name: str, rnd: Random) -> Call:
    """Return a call with nothing, one or two arguments made odd."""
    call = RECIPES[name](rnd)
    for _ in range(rnd.choice([0, 0, 1, 1, 1, 2])):
        if not call.arguments:
            break
        spoilt = rnd.choice(list(call.arguments))
        pictorial = hasattr(call.arguments[spoilt], "shape") and rnd.random() < 0.6
        call.arguments[spoilt] = odd.odd_picture(rnd) if pictorial else odd.anything(rnd)
        call.spoilt.append(spoilt)
        call.fine = False
    return call


# --- what is asked of results -----------------------------------------------------------------


def picture_size(image: Any) -> tuple[int, ...]:
    return tuple(np.shape(image.array if isinstance(image, odd.Given) else image)[:2])


def computed(result: Any) -> Any:
    return result.compute(scheduler="synchronous") if hasattr(result, "dask") else result


def values_of(
    result: Any, shape: tuple[int, ...] | None, dtype: str, low: float, high: float
) -> None:
    """Check shape, dtype and range of a result; NaN is in no range."""
    result = computed(result)
    assert isinstance(result, np.ndarray), f"it is a {type(result).__name__}"
    assert shape is None or result.shape == shape, f"shape {result.shape}, not {shape}"
    assert result.dtype == dtype, f"dtype {result.dtype}, not {dtype}"
    inside = ((result >= low) & (result <= high)).all()
    assert inside, f"values {result.min()} to {result.max()}, not from {low} to {high}"


def image_like(low: float, high: float, dtype: str = "float32") -> Callable[..., None]:
    """Return a check for an array as high and wide as the picture that came in."""

    def check(result: Any, arguments: dict[str, Any]) -> None:
        given = arguments.get("axes") is not None or arguments.get("channel_axis") is not None
        shape = None if given else picture_size(arguments["image"])
        values_of(result, shape, dtype, low, high)

    return check


def whole_picture(result: Any, arguments: dict[str, Any]) -> None:
    given = arguments.get("axes") is not None or arguments.get("channel_axis") is not None
    shape = None if given else odd.shape_of(arguments["image"])
    known = as_known(result, arguments["image"])
    values_of(known, shape, "float32", -math.inf, math.inf)
    assert np.isfinite(known).all()


def as_known(result: Any, image: Any) -> np.ndarray:
    """Return a picture with 0 for NaN if the one that it was made of has unknown pixels."""
    given, found = computed(image), computed(result)
    holes = np.ma.is_masked(given) or np.isnan(np.asarray(given, np.float64)).any()
    return np.where(np.isnan(found), np.float32(0), found) if holes else found


def anything_returned(result: Any, arguments: dict[str, Any]) -> None:
    """Be content: another check looks at the result, or there is nothing to say of it."""


def number_between(low: float, high: float) -> Callable[..., None]:
    def check(result: Any, arguments: dict[str, Any]) -> None:
        assert isinstance(result, float), f"it is a {type(result).__name__}"
        assert low <= result <= high, f"{result} is not from {low} to {high}"

    return check


# --- what goes in -----------------------------------------------------------------------------


def family(rnd: Random) -> Any:
    return rnd.choice(
        [
            nd.Disc(),
            nd.Disc(rnd.choice([1.0, 3.0, 5.5])),
            nd.Gaussian(rnd.choice([1.0, 3.0])),
            nd.Polygon(rnd.choice([3, 5, 8]), max_radius=4.0),
            nd.Annulus(0.4, 4.0),
            nd.GeneralizedGaussian(1.5, 2.0),
        ]
    )


def measured_family() -> Any:
    scales = np.array([1.0, 2.0, 3.0])
    return nd.MeasuredPSF(scales, np.array([_framed(nd.Disc().kernel(s)) for s in scales]))


def _framed(kernel: np.ndarray) -> np.ndarray:
    return np.pad(kernel, (9 - len(kernel)) // 2)


def some(rnd: Random, **choices: list[Any]) -> dict[str, Any]:
    """Give some of the optional arguments a value that is right."""
    return {name: rnd.choice(values) for name, values in choices.items() if rnd.random() < 0.4}


def light(rnd: Random) -> dict[str, Any]:
    return some(rnd, linearize=[None, "srgb"], intensity_range=[None, (0, 1), (0.0, 4095.0)])


@functools.lru_cache(maxsize=24)
def scene(number: int) -> tuple[Any, Any, Any]:
    """Return a picture, its candidates and its map."""
    rnd = Random(number)
    sides = ((48, 48), (41, 60), (20, 90), (64, 40))[number % 4]
    channels = ((), (3,), (4,))[number % 3]
    pixels = odd.locked(odd.texture(rnd, (*sides, *channels)))
    candidates = nd.estimate_candidates(pixels, psf=family(rnd), stride=rnd.choice([4, 7]))
    return pixels, candidates, odd.locked(nd.label_blur_map(candidates, pixels))


def any_scene(rnd: Random) -> tuple[Any, Any, Any]:
    return scene(rnd.randrange(12))


def map_for(rnd: Random, shape: tuple[int, int], largest: float = 3.0) -> Any:
    rng = np.random.default_rng(rnd.getrandbits(32))
    values = rnd.choice([rng.random(shape) * largest, np.full(shape, largest / 2), np.zeros(shape)])
    return odd.laid_out(rnd, values.astype(rnd.choice(["f4", "f8", ">f4", "f2"])))


def described(value: Any, length: int = 60) -> str:
    """Return a value in few words."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        layout = type(value).__name__ if type(value) is not np.ndarray else "array"
        return f"{layout} {value.dtype} {value.shape}"
    if isinstance(value, odd.Given):
        return f"Given({described(value.array)})"
    text = f"<{len(value)} bytes>" if isinstance(value, bytes) else repr(value)
    return " ".join(text.split())[:length]
