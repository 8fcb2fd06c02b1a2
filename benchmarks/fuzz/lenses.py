"""Random calls of PSF families, of what compares and measures them, and of thin lenses."""

import math
from random import Random
from typing import Any

import numpy as np

import napari_defocus as nd
from benchmarks.fuzz import values as odd
from benchmarks.fuzz.call import (
    Call,
    anything_returned,
    family,
    light,
    map_for,
    measured_family,
    recipe,
    some,
)


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
    return _family_call(nd.Gaussian, {"max_radius": rnd.choice([1, 2.5, np.int16(4)])}, rnd)


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
    asked = {"exponent": rnd.choice([1.0, 2, 5.0]), "max_radius": rnd.choice([1.0, 4])}
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


_FAMILY = ("psf", "max_radius", "obstruction", "blades", "exponent", "cannot read")


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

    return Call(nd.blur_from_depth, arguments, check)


@recipe("depth_from_blur")
def _to_depth(rnd: Random) -> Call:
    arguments = {"blur_map": map_for(rnd, (9, 8)), "lens": nd.ThinLens(**_lens_numbers(rnd))}
    asked = some(rnd, side=["far", "near", np.ones((9, 8), bool)])
    focused = math.isfinite(arguments["lens"].focus_distance_m)

    def check(result: Any, given: dict[str, Any]) -> None:
        assert result.dtype == np.float32
        assert not (result < 0).any()

    # Nothing is beyond infinity.
    return Call(nd.depth_from_blur, arguments | asked, check, focused)
