"""Random calls of what simulates, restores and refocuses pictures, and of stacks and regions."""

import tempfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import napari_defocus as nd
from benchmarks.fuzz import values as odd
from benchmarks.fuzz.call import (
    Call,
    as_known,
    family,
    map_for,
    picture_size,
    recipe,
    some,
    values_of,
    whole_picture,
)


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
    assert np.isfinite(as_known(result, given["image"])).all()


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
    arguments |= some(rnd, align=["auto", True, False], match_brightness=["auto", True, False])
    arguments |= some(rnd, blend=[True, False])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert np.isfinite(result.position).all()
        assert result.plane.min() >= 0
        values_of(result.confidence, result.position.shape, "float32", 0, 1)
        assert abs(result.share_of_plane.sum() - 1) < 1e-6

    # Some stacks show no focus at all.
    return Call(nd.sharpest_plane, arguments, check, fine="px_per_plane" in arguments)


@recipe("composite_at")
def _composite(rnd: Random) -> Call:
    shape = (rnd.choice([2, 3, 5]), rnd.choice([17, 30]), rnd.choice([17, 33]))
    stack = odd.typed(rnd, odd.texture(rnd, shape))
    position = np.random.default_rng(rnd.randrange(99)).uniform(0, shape[0] - 1, shape[1:])
    arguments = {"position": position, "stack": odd.laid_out(rnd, stack), "axes": "zyx"}
    arguments |= some(rnd, match_brightness=["auto", True, False], blend=[True, False])

    def check(result: Any, given: dict[str, Any]) -> None:
        assert result.shape == given["position"].shape
        assert result.dtype == given["stack"].dtype

    return Call(nd.composite_at, arguments, check)


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
