"""Random calls of what measures: candidates, maps, masks, noise, explanations."""

import functools
import math
from random import Random
from typing import Any

import numpy as np

import napari_defocus as nd
from benchmarks.fuzz import values as odd
from benchmarks.fuzz.call import (
    Call,
    any_scene,
    anything_returned,
    family,
    image_like,
    light,
    number_between,
    picture_size,
    recipe,
    scene,
    some,
    values_of,
)

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
    check = number_between(0, 1e15)
    return Call(nd.estimate_noise_variance, arguments, check, _of_its_own_range(arguments))


@recipe("picture_remarks")
def _remarks(rnd: Random) -> Call:
    arguments = {"image": odd.picture(rnd)} | some(rnd, window=[17, 41])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert isinstance(result, list)
        assert all(isinstance(remark, str) for remark in result)

    return Call(nd.picture_remarks, arguments, check)


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
    arguments |= some(rnd, offset=[0.0, 0.0015, -0.1])

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
    arguments["threshold"] = rnd.choice([0, 0.5, 0.999, "auto"])
    asked = some(rnd, seeds=[odd.laid_out(rnd, seeds)], smoothness=[0, 10, 1e9], color_sigma=[1])
    asked |= some(rnd, within=[odd.laid_out(rnd, _marked(rnd, pixels))], unknown=["fill", "leave"])
    return Call(nd.segment_in_focus, arguments | asked, image_like(0, 2, "uint8"))


def _marked(rnd: Random, pixels: np.ndarray) -> np.ndarray:
    marks = np.zeros(pixels.shape[:2], rnd.choice(["?", "u1", "i4"]))
    marks[:5, 1:] = 1
    return marks


@recipe("focus_threshold")
def _threshold(rnd: Random) -> Call:
    pixels, candidates, _ = any_scene(rnd)
    arguments = {"candidates": candidates, "image": odd.laid_out(rnd, pixels)}
    asked = some(rnd, within=[odd.laid_out(rnd, _marked(rnd, pixels))])
    return Call(nd.focus_threshold, arguments | asked, number_between(0, 3.5))


@recipe("known_places")
def _known(rnd: Random) -> Call:
    pixels, candidates, _ = any_scene(rnd)
    arguments = {"candidates": candidates, "image": odd.laid_out(rnd, pixels)}
    return Call(nd.known_places, arguments, image_like(0, 1, "bool"))


@recipe("matte_in_focus")
def _matte(rnd: Random) -> Call:
    pixels, _, _ = any_scene(rnd)
    arguments = {"image": odd.laid_out(rnd, pixels), "mask": _marked(rnd, pixels)}
    # Without PyMatting, which is no part of the usual installation, it is refused.
    asked = some(rnd, width=[1, 4, 300])
    return Call(nd.matte_in_focus, arguments | asked, image_like(0, 1), fine=False)


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
