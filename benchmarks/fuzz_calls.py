"""Random calls of every public function, for fuzz.py: what goes in, and what must come out."""

import functools
import inspect
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import fuzz_values as odd
import numpy as np

import napari_defocus as nd
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings


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
    values_of(result, shape, "float32", -math.inf, math.inf)
    assert np.isfinite(computed(result)).all()


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


# --- estimation -------------------------------------------------------------------------------

NUMBERS = {"noise_variance": [None, 0.0, 1e-6, 1e-3, 1], "smoothness": [0, 5.0, 20, 1e6]}


def _of_its_own_range(arguments: dict[str, Any]) -> bool:
    """Return whether nothing is too bright: integers may be 1e18 times as large as a range."""
    return arguments.get("intensity_range") is None


def _estimation(rnd: Random) -> dict[str, Any]:
    asked = some(
        rnd, window=[17, 29, 41], stride=[2, 3], mode=["curve", "paper"], psf=[family(rnd)]
    )
    return asked | some(rnd, noise_variance=NUMBERS["noise_variance"]) | light(rnd)


@recipe("estimate_candidates")
def _candidates(rnd: Random) -> Call:
    arguments = {"image": odd.picture(rnd)} | _estimation(rnd)
    arguments |= some(rnd, spectra=["exact", "fitted"], search=["lattice"])

    def check(result: Any, given: dict[str, Any]) -> None:
        if not isinstance(result, nd.BlurCandidates):
            return
        assert result.image_shape == picture_size(given["image"])
        assert np.isfinite(result.curve).all()
        assert not np.isinf(result.radii).any()

    return Call(nd.estimate_candidates, arguments, check, _of_its_own_range(arguments))


@recipe("estimate_blur_map")
def _blur_map(rnd: Random) -> Call:
    arguments = {"image": odd.picture(rnd)} | _estimation(rnd)
    arguments |= some(
        rnd,
        smoothness=NUMBERS["smoothness"],
        color_sigma=[0.01, 1.0],
        return_confidence=[False, True],
        block_size=[256, 1024],
    )

    def check(result: Any, given: dict[str, Any]) -> None:
        if isinstance(result, tuple):
            image_like(0, 1)(result[1], given)
            result = result[0]
        image_like(0, 1e9)(result, given)

    return Call(nd.estimate_blur_map, arguments, check, _of_its_own_range(arguments))


@recipe("estimate_blur_map of stacks")
def _stack_of_maps(rnd: Random) -> Call:
    shape, axes = rnd.choice(
        [
            ((2, 20, 24), "zyx"),
            ((24, 2, 20), "yzx"),
            ((1, 2, 16, 17, 3), "tzyxs"),
            ((3, 20, 9), "syx"),
        ]
    )
    stack = odd.typed(rnd, odd.texture(rnd, shape))
    stack = odd.lazy(rnd, stack) if rnd.random() < 0.5 else stack
    order = {"axes": axes} if rnd.random() < 0.7 else {"channel_axis": None, "axes": axes}
    arguments = {"image": stack, "window": 17, "stride": 4} | order

    def check(result: Any, given: dict[str, Any]) -> None:
        values_of(result, None, "float32", 0, 1e9)

    return Call(nd.estimate_blur_map, arguments, check)


@recipe("estimate_noise_variance")
def _noise(rnd: Random) -> Call:
    arguments = {"image": odd.picture(rnd)} | light(rnd)
    check = number_between(0, 1e9)
    return Call(nd.estimate_noise_variance, arguments, check, _of_its_own_range(arguments))


@recipe("estimate_shot_noise")
def _shot_noise(rnd: Random) -> Call:
    def check(result: Any, given: dict[str, Any]) -> None:
        assert 0 <= result.read_variance < math.inf
        assert 0 <= result.gain < math.inf

    # Pictures without noise are refused.
    arguments = {"image": odd.picture(rnd)} | light(rnd)
    return Call(nd.estimate_shot_noise, arguments, check, fine=False)


@recipe("ShotNoise")
def _shot_noise_at(rnd: Random) -> Call:
    arguments = {"read_variance": rnd.choice([0, 1e-6, 0.5]), "gain": rnd.choice([0.0, 1e-4, 2])}

    def check(result: Any, given: dict[str, Any]) -> None:
        assert (np.asarray(result.variance_at(np.linspace(0, 1, 5))) >= 0).all()

    # Both may be 0.
    return Call(nd.ShotNoise, arguments, check, fine=False)


@recipe("label_blur_map")
def _labels(rnd: Random) -> Call:
    pixels, candidates, _ = any_scene(rnd)
    arguments = {"candidates": candidates, "image": odd.laid_out(rnd, pixels)}
    asked = some(rnd, smoothness=NUMBERS["smoothness"], color_sigma=[1e-3, 5.0])
    return Call(nd.label_blur_map, arguments | asked, image_like(0, 8.001))


@recipe("labeling_energy")
def _energy(rnd: Random) -> Call:
    pixels, candidates, blur_map = any_scene(rnd)
    arguments = {
        "blur_map": odd.laid_out(rnd, blur_map),
        "candidates": candidates,
        "image": odd.laid_out(rnd, pixels),
    }
    return Call(nd.labeling_energy, arguments, number_between(-1e300, 1e300))


@recipe("segment_in_focus")
def _segmentation(rnd: Random) -> Call:
    pixels, candidates, _ = any_scene(rnd)
    seeds = np.zeros(pixels.shape[:2], rnd.choice(["u1", "i4", "i8"]))
    seeds[:3, :3] = 1
    arguments = {"candidates": candidates, "image": odd.laid_out(rnd, pixels)}
    arguments["threshold"] = rnd.choice([0, 0.5, 0.999])
    asked = some(rnd, seeds=[odd.laid_out(rnd, seeds)], smoothness=[0, 10, 1e9], color_sigma=[1])
    return Call(nd.segment_in_focus, arguments | asked, image_like(0, 1, "uint8"))


@recipe("confidence_map")
def _confidence(rnd: Random) -> Call:
    _, candidates, blur_map = any_scene(rnd)
    arguments = {"candidates": candidates, "blur_map": odd.laid_out(rnd, blur_map)}

    def check(result: Any, given: dict[str, Any]) -> None:
        values_of(result, candidates.image_shape, "float32", 0, 1)

    return Call(nd.confidence_map, arguments, check)


@recipe("cautious_blur_map")
def _caution(rnd: Random) -> Call:
    _, candidates, blur_map = any_scene(rnd)
    arguments = {"candidates": candidates, "blur_map": odd.laid_out(rnd, blur_map)}

    def check(result: Any, given: dict[str, Any]) -> None:
        values_of(result, candidates.image_shape, "float32", 0, 1e300)

    return Call(nd.cautious_blur_map, arguments | some(rnd, risk=[0, 0.1, 1, True]), check)


@recipe("BlurCandidates.log_likelihood_at")
def _curve_at(rnd: Random) -> Call:
    _, candidates, _ = any_scene(rnd)
    place = {"row": rnd.choice([0, 3.5, 19]), "column": rnd.choice([0, 0.25, 39])}

    def check(result: Any, given: dict[str, Any]) -> None:
        scales, curve = result
        assert scales.shape == curve.shape
        assert np.isfinite(curve).all()

    return Call(candidates.log_likelihood_at, place, check)


@recipe("BlurCandidates.window_at")
def _window_at(rnd: Random) -> Call:
    _, candidates, _ = any_scene(rnd)
    place = {"row": rnd.choice([0, 3.5, 19]), "column": rnd.choice([0, 0.25, 39])}

    def check(result: Any, given: dict[str, Any]) -> None:
        assert np.isfinite(result).all()

    return Call(rnd.choice([candidates.window_at, candidates.nearest_window]), place, check)


@recipe("explain_pixel")
def _explanation(rnd: Random) -> Call:
    pixels, candidates, blur_map = any_scene(rnd)
    arguments = {"candidates": candidates, "row": rnd.choice([0, 5, 19]), "column": 7}
    arguments |= some(rnd, blur_map=[odd.laid_out(rnd, blur_map)], image=[pixels])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert isinstance(result.summary(), str)
        assert all(isinstance(line, str) for line in result.remarks())
        assert isinstance(result.carried_in, bool | np.bool_)
        assert result.best is None or math.isfinite(result.best)

    return Call(nd.explain_pixel, arguments, check)


@functools.cache
def _some_explanation() -> Any:
    pixels, candidates, blur_map = scene(1)
    return nd.explain_pixel(candidates, 5, 7, blur_map=blur_map, image=pixels)


@recipe("draw_explanation")
def _drawing(rnd: Random) -> Call:
    from matplotlib.figure import Figure

    arguments = {"explanation": _some_explanation(), "axes": Figure().add_subplot()}
    asked = some(rnd, floor=[-20, -0.5])
    draw = functools.partial(nd.draw_explanation, legend=rnd.random() < 0.5)
    return Call(draw, arguments | asked, anything_returned)


# --- lenses -----------------------------------------------------------------------------------


def _family_call(make: Any, arguments: dict[str, Any], rnd: Random) -> Call:
    def build(**given: Any) -> Any:
        scale = given.pop("scale")
        return make(**given).kernel(scale)

    def check(result: Any, given: dict[str, Any]) -> None:
        assert result.ndim == 2
        assert result.dtype == np.float64
        assert result.shape[0] == result.shape[1]
        assert result.shape[0] % 2 == 1
        assert abs(result.sum() - 1) < 1e-9
        assert (result >= 0).all()

    arguments["scale"] = rnd.choice([0, 0.3, 0.5, 1, 1.0])
    return Call(build, arguments, check, names=("scale",))


@recipe("Disc")
def _disc(rnd: Random) -> Call:
    return _family_call(nd.Disc, {"max_radius": rnd.choice([1, 3.0, np.float32(8), 60])}, rnd)


@recipe("Gaussian")
def _gaussian(rnd: Random) -> Call:
    return _family_call(nd.Gaussian, {"max_sigma": rnd.choice([1, 2.5, np.int16(4)])}, rnd)


@recipe("Annulus")
def _annulus(rnd: Random) -> Call:
    asked = {"obstruction": rnd.choice([0.0, 0.5, 0.9]), "max_radius": rnd.choice([1.0, 8])}
    return _family_call(nd.Annulus, asked, rnd)


@recipe("Polygon")
def _polygon(rnd: Random) -> Call:
    asked = {"blades": rnd.choice([3, 6, 12]), "rotation": rnd.choice([0, -400.5]), "max_radius": 5}
    return _family_call(nd.Polygon, asked, rnd)


@recipe("GeneralizedGaussian")
def _generalized(rnd: Random) -> Call:
    asked = {"exponent": rnd.choice([1.0, 2, 5.0]), "max_sigma": rnd.choice([1.0, 4])}
    return _family_call(nd.GeneralizedGaussian, asked, rnd)


@recipe("KernelFunction")
def _kernel_function(rnd: Random) -> Call:
    returned = odd.anything(rnd) if rnd.random() < 0.5 else np.ones((3, 3))
    call = _family_call(nd.KernelFunction, {"function": lambda scale: returned}, rnd)
    call.arguments |= some(rnd, max_scale=[1.0, 5], scale_name=["radius (px)"])
    call.fine = isinstance(returned, np.ndarray) and returned.shape == (3, 3)
    return call


@recipe("MeasuredPSF")
def _measured(rnd: Random) -> Call:
    psf = measured_family()
    asked = {"scales": odd.laid_out(rnd, psf.scales), "kernels": odd.laid_out(rnd, psf.kernels)}
    asked |= some(rnd, max_scale=[3.0, 4], provenance=[None, {"lens": "50 mm"}])
    return _family_call(nd.MeasuredPSF, asked, rnd)


_FAMILY = ("psf", "max_radius", "max_sigma", "obstruction", "blades", "exponent", "cannot read")


@recipe("psf_from_text")
def _psf_text(rnd: Random) -> Call:
    texts = ["disc", "polygon:6", "polygon:5:30", "annulus:0.3", "gaussian", "Disc "]
    odd_texts = ["polygon:", "polygon:2", "disc:1", "annulus:nan", "a" * 9999, ":", "x.npz", "\0"]
    text = rnd.choice(texts + odd_texts)
    arguments = {"text": text} | some(rnd, max_scale=[None, 1, 3.5])
    return Call(nd.psf_from_text, arguments, anything_returned, text in texts, _FAMILY)


@recipe("fit_report")
def _fit(rnd: Random) -> Call:
    arguments = {"psf": family(rnd)} | some(rnd, window=[17, 41])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert math.isfinite(result.rms)
        assert math.isfinite(result.maximum)

    return Call(nd.fit_report, arguments, check, names=("function",))


@recipe("compare_psf")
def _comparison(rnd: Random) -> Call:
    shape = (rnd.choice([41, 48, 60]), rnd.choice([41, 50]))
    noisy = np.random.default_rng(rnd.getrandbits(32)).random(shape)
    arguments = {"image": odd.laid_out(rnd, noisy), "families": [nd.Disc(3.0), nd.Gaussian(2.0)]}

    def check(result: Any, given: dict[str, Any]) -> None:
        assert abs(sum(row.share for row in result.rows) - 1) < 1e-6
        assert result.best is result.rows[0].psf or result.best is not None

    # Noise alone shows no blur: it may be refused for that.
    arguments |= some(rnd, window=[17, 41]) | light(rnd)
    return Call(nd.compare_psf, arguments, check, False, ("psf",))


@recipe("calibrate_psf")
def _calibration(rnd: Random) -> Call:
    sharp = np.random.default_rng(rnd.getrandbits(32)).random((64, 64))
    blurred = [nd.simulate_defocus(sharp, np.full(sharp.shape, r)) for r in (1.0, 2.5)]
    arguments = {"pictures": blurred, "sharp": odd.laid_out(rnd, sharp)}
    arguments |= some(rnd, scales=[None, [1.0, 2.5]], names=[None, ["a", "b"]], max_scale=[None, 4])
    return Call(nd.calibrate_psf, arguments, anything_returned, fine=False)


@recipe("ThinLens")
def _thin_lens(rnd: Random) -> Call:
    def check(result: Any, given: dict[str, Any]) -> None:
        assert 0 <= result.largest_radius < math.inf

    return Call(nd.ThinLens, _lens_numbers(rnd), check)


def _lens_numbers(rnd: Random) -> dict[str, Any]:
    return {
        "focal_length_mm": rnd.choice([5, 50.0, np.float32(200)]),
        "f_number": rnd.choice([1.4, 22]),
        "focus_distance_m": rnd.choice([0.5, 2, 1e6, math.inf]),
        "pixel_pitch_um": rnd.choice([1, 6.5]),
    }


@recipe("blur_from_depth")
def _from_depth(rnd: Random) -> Call:
    depth = np.random.default_rng(rnd.getrandbits(32)).random((9, 8)) * 10 + 0.3
    arguments = {"depth": odd.laid_out(rnd, depth), "lens": nd.ThinLens(**_lens_numbers(rnd))}

    def check(result: Any, given: dict[str, Any]) -> None:
        assert result.dtype == np.float32
        assert not (result < 0).any()

    return Call(nd.blur_from_depth, arguments | some(rnd, psf=[family(rnd)]), check)


@recipe("depth_from_blur")
def _to_depth(rnd: Random) -> Call:
    arguments = {"blur_map": map_for(rnd, (9, 8)), "lens": nd.ThinLens(**_lens_numbers(rnd))}
    asked = some(rnd, side=["far", "near", np.ones((9, 8), bool)], psf=[family(rnd)])
    focused = math.isfinite(arguments["lens"].focus_distance_m)

    def check(result: Any, given: dict[str, Any]) -> None:
        assert result.dtype == np.float32
        assert not (result < 0).any()

    # Nothing is beyond infinity.
    return Call(nd.depth_from_blur, arguments | asked, check, focused)


@recipe("depth_surface")
def _surface(rnd: Random) -> Call:
    arguments = {"depth": map_for(rnd, (20, 24)) if rnd.random() < 0.5 else np.full((20, 24), 2.0)}
    arguments |= some(rnd, step=[None, 1, 3], largest_jump=[0, 0.5], relief=[0, 0.5, 1])
    arguments |= some(rnd, image=[None, odd.picture(rnd, (20, 24))])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert np.isfinite(result.vertices).all()
        assert result.faces.size == 0 or result.faces.max() < len(result.vertices)
        assert result.colors is None or len(result.colors) == len(result.vertices)

    # A depth of 0 is none.
    return Call(nd.depth_surface, arguments, check, fine=False)


# --- pictures made ----------------------------------------------------------------------------


@recipe("simulate_defocus")
def _simulation(rnd: Random) -> Call:
    shape = (rnd.choice(odd.SIDES), rnd.choice(odd.SIDES))
    arguments = {"image": odd.picture(rnd, shape), "blur_map": map_for(rnd, shape, 1.0)}
    arguments |= some(rnd, psf=[family(rnd)], noise_variance=[0, 1e-4], rng=[None, 3])
    return Call(nd.simulate_defocus, arguments, simulated)


def simulated(result: Any, given: dict[str, Any]) -> None:
    shape = odd.shape_of(given["image"])
    assert result.shape in (shape, (*shape[:2], 3)), f"shape {result.shape} of {shape}"
    assert result.dtype == np.float32
    assert np.isfinite(result).all()


@recipe("simulate_layered_defocus")
def _layered(rnd: Random) -> Call:
    shape = (rnd.choice([12, 30, 48]), rnd.choice([12, 40]))
    depth = np.where(np.indices(shape)[0] > 6, 1.0, 2.0)
    arguments = {"image": odd.picture(rnd, shape), "depth": odd.laid_out(rnd, depth)}
    arguments["radius_of_depth"] = rnd.choice([lambda d: d, lambda d: 1.0, np.square])
    arguments |= some(rnd, layers=[2, 5], noise_variance=[0, 1e-4], psf=[family(rnd)])

    def check(result: Any, given: dict[str, Any]) -> None:
        simulated(result[0], given)
        values_of(result[1], picture_size(given["image"]), "float32", 0, 1e9)

    # What the user's function returns may be wrong.
    return Call(nd.simulate_layered_defocus, arguments, check, fine=False)


@recipe("restore_all_in_focus")
def _restoration(rnd: Random) -> Call:
    shape = (rnd.choice([3, 5, 17, 40]), rnd.choice([3, 16, 48]))
    arguments = {"image": odd.picture(rnd, shape), "blur_map": map_for(rnd, shape, 1.0)}
    arguments |= some(rnd, noise_variance=[0, 1e-5, 1], tv_weight=[1e-4, 10], linearize=["srgb"])
    arguments |= some(rnd, psf=[family(rnd)], confidence=[map_for(rnd, shape, 1.0)])
    return Call(nd.restore_all_in_focus, arguments, whole_picture)


@recipe("change_focus")
def _refocusing(rnd: Random) -> Call:
    shape = (rnd.choice([12, 30]), rnd.choice([16, 40]))
    arguments = {"image": odd.picture(rnd, shape), "blur_map": map_for(rnd, shape, 1.0)}
    arguments |= some(rnd, focus=[0, 1.0, -0.5], aperture=[0, 0.5, 2], side=["far", "near"])
    arguments |= some(rnd, noise_variance=[0, 1e-5], linearize=[None, "srgb"])
    return Call(nd.change_focus, arguments, whole_picture)


# --- stacks, tables, files --------------------------------------------------------------------


@recipe("sharpest_plane")
def _sharpest(rnd: Random) -> Call:
    shape = (rnd.choice([2, 3, 5]), rnd.choice([17, 30]), rnd.choice([17, 33]))
    colors = rnd.random() < 0.3
    stack = odd.typed(rnd, odd.texture(rnd, (*shape, 3) if colors else shape))
    arguments = {
        "stack": odd.lazy(rnd, stack) if rnd.random() < 0.3 else odd.laid_out(rnd, stack),
        "axes": "zyxs" if colors else "zyx",
    }
    arguments |= some(rnd, px_per_plane=[0.5, 2], noise_variance=[1e-5], window=[17, 41])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert np.isfinite(result.position).all()
        assert result.plane.min() >= 0
        values_of(result.confidence, result.position.shape, "float32", 0, 1)
        assert abs(result.share_of_plane.sum() - 1) < 1e-6

    # Some stacks show no focus at all.
    return Call(nd.sharpest_plane, arguments, check, fine="px_per_plane" in arguments)


@recipe("focus_curve")
def _focus_curve(rnd: Random) -> Call:
    maps = np.random.default_rng(rnd.getrandbits(32)).random((3, 8, 9)).astype("f4") * 4
    arguments = {"blur_maps": odd.laid_out(rnd, maps)}
    arguments |= some(rnd, threshold=[1, 2.0], min_confidence=[0, 1], confidence=[maps / 4])
    arguments |= some(rnd, in_focus=[(maps > 2).astype(np.uint8), maps > 1])

    def check(result: Any, given: dict[str, Any]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            result.save(Path(folder, "curve.csv"))
            assert Path(folder, "curve.csv").stat().st_size > 10
        assert result.best is None or isinstance(result.best, tuple)

    return Call(nd.focus_curve, arguments, check)


@recipe("measure_regions")
def _regions(rnd: Random) -> Call:
    rng = np.random.default_rng(rnd.getrandbits(32))
    mask = rng.random((20, 30)) > rnd.choice([0.1, 0.9])
    arguments = {"in_focus": odd.laid_out(rnd, rnd.choice([mask, mask.astype("u1")]))}
    arguments |= some(rnd, blur_map=[map_for(rnd, (20, 30))], min_area=[1, 16, 10**6])
    arguments |= some(rnd, pixel_size=[0.5, (1, 2)], unit=["um", "ü"])

    def check(result: Any, given: dict[str, Any]) -> None:
        labels, table = result
        assert labels.dtype == np.int32
        assert labels.max() == len(table) - 0 or len(table.columns)
        assert table.as_csv().decode("utf-8")

    return Call(nd.measure_regions, arguments, check)


@recipe("Settings")
def _settings(rnd: Random) -> Call:
    kinds = {
        "map": MapSettings,
        "mask": MaskSettings,
        "restoration": RestorationSettings,
        "refocus": RefocusSettings,
    }
    name = rnd.choice(list(kinds))
    kind = kinds[name]
    defaults = {f: getattr(kind(), f) for f in kind.__dataclass_fields__}
    chosen = rnd.sample(list(defaults), rnd.randint(1, len(defaults)))

    def build(**given: Any) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            settings = nd.Settings(**{name: kind(**given)})
            settings.save(Path(folder, "s.json"))
            # JSON has no whole numbers as large as those of Python.
            large = any(isinstance(v, int) and abs(v) > 2**53 for v in given.values())
            loaded = nd.Settings.load(Path(folder, "s.json"))
            assert large or loaded == settings, "loaded as another"
            return settings

    return Call(build, {f: defaults[f] for f in chosen}, anything_returned, names=(name,))


@recipe("Settings.load")
def _settings_file(rnd: Random) -> Call:
    with tempfile.TemporaryDirectory() as folder:
        nd.Settings().save(Path(folder, "s.json"))
        content = Path(folder, "s.json").read_bytes()
    spoilt = _spoilt_bytes(rnd, content)
    return _loading(spoilt, nd.Settings.load)


@recipe("MeasuredPSF.load")
def _psf_file(rnd: Random) -> Call:
    with tempfile.TemporaryDirectory() as folder:
        measured_family().save(Path(folder, "p.npz"))
        content = Path(folder, "p.npz").read_bytes()
    spoilt = _spoilt_bytes(rnd, content)
    return _loading(spoilt, nd.MeasuredPSF.load)


@recipe("ThinLens.from_exif")
def _lens_file(rnd: Random) -> Call:
    spoilt = _spoilt_bytes(rnd, _photograph())

    def load(path: Path) -> Any:
        return nd.ThinLens.from_exif(path, focus_distance_m=2.0, pixel_pitch_um=5.0)

    return _loading(spoilt, load)


@functools.cache
def _photograph() -> bytes:
    import io

    from PIL import Image

    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x920A: 50.0, 0x829D: 2.8})
    buffer = io.BytesIO()
    Image.new("RGB", (30, 20)).save(buffer, "JPEG", exif=exif)
    return buffer.getvalue()


def _loading(content: bytes, load: Callable[[Path], Any]) -> Call:
    """Return a call that reads a file; its name, or that of the content, is in messages."""

    def loaded() -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "file.spoilt")
            path.write_bytes(content)
            return load(path)

    return Call(loaded, {}, anything_returned, False, ("file.spoilt",))


def _spoilt_bytes(rnd: Random, content: bytes) -> bytes:
    """Return a file that is cut off, or of which some bytes are others."""
    if rnd.random() < 0.3:
        return content[: rnd.randrange(len(content))]
    changed = bytearray(content)
    for _ in range(rnd.choice([0, 1, 1, 2, 5, 40])):
        changed[rnd.randrange(len(changed))] = rnd.choice(
            [0, 34, 44, 48, 57, 255, rnd.randrange(256)]
        )
    return bytes(changed)


@recipe("measure_batch")
def _batch(rnd: Random) -> Call:
    """Only what is refused: whole batches start processes, and have tests of their own."""
    arguments = some(rnd, min_confidence=[0.5], block_size=[10, 256])
    call = functools.partial(nd.measure_batch, rnd.choice(["none.png", ["none.png"], []]))
    names = ("none.png", "/dev/null/none")
    return Call(
        functools.partial(call, "/dev/null/none"), arguments, anything_returned, False, names
    )


def described(value: Any, length: int = 60) -> str:
    """Return a value in few words."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        layout = type(value).__name__ if type(value) is not np.ndarray else "array"
        return f"{layout} {value.dtype} {value.shape}"
    if isinstance(value, odd.Given):
        return f"Given({described(value.array)})"
    text = f"<{len(value)} bytes>" if isinstance(value, bytes) else repr(value)
    return " ".join(text.split())[:length]
