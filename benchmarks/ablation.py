"""What each step beyond the paper gains: one is left out at a time, everything else stays.

A part of run_all.py. Where no public argument leaves a step out, the function that does it is
replaced for the time of one measurement by what the paper does, or by nothing.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np
from measures import THRESHOLD, decided, overlap
from peers import luminance
from pictures import at_windows, middle, ramp
from record import Number, Record
from scenes import Group, Picture, Scenes, eight_bits

from napari_defocus import (
    estimate_candidates,
    estimate_shot_noise,
    label_blur_map,
    segment_in_focus,
    simulate_defocus,
)
from napari_defocus.core.image import decode_srgb, encode_srgb
from napari_defocus.labeling.blur_map import CURVE_WEIGHT
from napari_defocus.labeling.data_term import artificial_likelihood
from napari_defocus.labeling.graph_cuts import expand_until_settled
from napari_defocus.likelihood.blur_spectra import LABEL_STEP, spectrum_table
from napari_defocus.likelihood.gabor import local_power
from napari_defocus.likelihood.profile_likelihood import profile_log_likelihood

DEFAULT = "everything (the default)"
PAPERS_NOISE = 1e-4
NO_COLORS = 1e3
NORMAL_MEDIAN = 0.6745
NOISE = 1e-5
WITH_FLATS = "ramp, camera, wall and sky"
SEARCHED, SEARCHED_SIDE = 3, 150
SHOT_GAIN, READ_VARIANCE = 4e-4, 1e-6


@dataclass(frozen=True)
class Step:
    """Something that can be left out.

    Attributes
    ----------
    name : str
        What is there instead.
    estimate, label : dict
        Arguments of `estimate_candidates` and `label_blur_map`; those that are functions are
        called with the picture.
    replaced : dict
        Dotted names below `napari_defocus`, and what takes their place.
    mask : bool
        Whether the mask is still a fair one.
    """

    name: str
    estimate: dict = field(default_factory=dict)
    label: dict = field(default_factory=dict)
    replaced: dict = field(default_factory=dict)
    mask: bool = True

    @contextmanager
    def left_out(self) -> Iterator[None]:
        with ExitStack() as stack:
            for name, instead in self.replaced.items():
                stack.enter_context(patch(f"napari_defocus.{name}", instead))
            yield

    def arguments(self, picture: np.ndarray) -> dict:
        return {k: v(picture) if callable(v) else v for k, v in self.estimate.items()}


def wavelet_noise(picture: np.ndarray) -> float:
    """Estimate the noise variance from the finest diagonal Haar wavelets (Donoho, Johnstone)."""
    luma = luminance(picture)
    height, width = (length // 2 * 2 for length in luma.shape)
    even, odd = luma[:height:2, :width], luma[1:height:2, :width]
    diagonal = (even[:, ::2] - even[:, 1::2] - odd[:, ::2] + odd[:, 1::2]) / 2
    return float((np.median(np.abs(diagonal)) / NORMAL_MEDIAN) ** 2)


def one_gradient(*arguments):
    power = local_power(*arguments)
    power[..., 1, :] = 0
    return power


def unmixed(psf, window, rows, columns, spectra, mixed=False):
    return spectrum_table(psf, window, rows, columns, spectra)


def undispersed(power, table, scales, noise_variance):
    curves = profile_log_likelihood(power, table, scales, noise_variance)
    return curves, np.ones(power.shape[:2], np.float32)


def three_candidates(candidates):
    return -np.log(artificial_likelihood(candidates)).astype(np.float32) / CURVE_WEIGHT


def all_informed(candidates):
    return np.ones(candidates.curve.shape[:2], np.float32)


def only_blocks(labels, cost, blocks, *_, **__):
    return blocks.spread(labels)


def unrefined(candidates, labels, *_):
    return np.float32(LABEL_STEP) * labels


STEPS = (
    Step(DEFAULT),
    Step("the paper's method, noise found by us", {"mode": "paper"}),
    Step("the paper's method and its noise variance, 1e-4",
         {"mode": "paper", "noise_variance": PAPERS_NOISE}),
    Step("noise variance 1e-4 for all", {"noise_variance": PAPERS_NOISE}),
    Step("noise by wavelets", {"noise_variance": wavelet_noise}),
    Step("one gradient", replaced={"likelihood.estimation.local_power": one_gradient}),
    Step("fitted spectra (12)", {"spectra": "fitted"}),
    Step("spectra of single scales", replaced={"likelihood.estimation.spectrum_table": unmixed}),
    Step("no dispersion", replaced={"likelihood.estimation.quasi_log_likelihood": undispersed}),
    Step("no own side at edges", replaced={"labeling.problem.on_own_side": lambda own, _: own}),
    Step("windows without texture have a say",
         replaced={"labeling.data_term.evidence_share": all_informed}),
    Step("three candidates, not the whole curve",
         replaced={"labeling.problem.data_term": three_candidates}, mask=False),
    Step("expansions, not fusions from an exact start",
         replaced={"labeling.blur_map.minimize_energy": expand_until_settled}),
    Step("labels, not refined", replaced={"labeling.blur_map.refine_labels": unrefined}),
    Step("blocks, not pixels at edges",
         replaced={"labeling.blur_map.label_pixels": only_blocks,
                   "labeling.segmentation.label_pixels": only_blocks}),
    Step("no colours", label={"color_sigma": NO_COLORS}),
    Step("blocks pay all of the mask's smoothness",
         replaced={"labeling.segmentation._BLOCK_SHARE": 1.0}),
    Step("windows of 31 px", {"window": 31}),
    Step("windows of 61 px", {"window": 61}),
    Step("windows 8 px apart", {"stride": 8}),
)  # fmt: skip
"""The two gradients, and what follows them, in the order of the method."""

OPTIONS = {
    "linear light, 8 bits": Step('linearize="srgb"', {"linearize": "srgb"}),
    "shot noise": Step("estimate_shot_noise", {"noise_variance": estimate_shot_noise}),
}
MASK, EDGES, ELSEWHERE = "mask, intersection over union", "mean error at edges", "elsewhere"


def measure_ablation(
    sources: dict[str, np.ndarray], record: Record, *, quick: bool, seed: int
) -> None:
    """Add errors of every step left out, on ramps, bumps, layers and JPEG, and its time."""
    scenes = Scenes(sources, seed)
    groups = [scenes.group(family, f"noise {NOISE:.0e}", NOISE) for family in scenes.families()] + [
        scenes.group("ramp", "JPEG 90", NOISE, quality=90)
    ]
    for group in groups[:3:2] if quick else groups:
        found: dict[tuple[str, str], list[float]] = defaultdict(list)
        for picture in group.make():
            timed_figures(STEPS[0], picture, group)  # compiled and read
            figures = {step.name: timed_figures(step, picture, group) for step in STEPS}
            seconds = figures[DEFAULT]["time"]
            for step, values in figures.items():
                values["time"] /= seconds
                for measure, value in values.items():
                    found[measure, step].append(value)
        for (measure, step), values in found.items():
            kind = ("", "lower", "runs") if measure == "time" else unit_of(measure)
            record.add(Number(f"without a step: {group.name}", measure, step, tuple(values), *kind))
        print(f"steps left out on: {group.name}", flush=True)
    measure_options(sources, record, seed)
    measure_search(sources, record)


def unit_of(measure: str) -> tuple[str, str]:
    return ("", "higher") if measure == MASK else ("px", "lower")


def timed_figures(step: Step, picture: Picture, group: Group) -> dict[str, float]:
    """Return the errors, the mask's overlap, and the seconds of one picture."""
    with step.left_out():
        began = time.perf_counter()
        candidates = estimate_candidates(picture.seen, **step.arguments(picture.seen))
        blur_map = label_blur_map(candidates, picture.seen, **step.label)
        seconds = time.perf_counter() - began
        label = {"threshold": THRESHOLD} | step.label
        mask = segment_in_focus(candidates, picture.seen, **label) == 1
    error = np.abs(blur_map - picture.truth)
    clear = picture.known & decided(picture.truth)
    figures = {"mean error": error[picture.known].mean(), "time": seconds}
    if group.layered:
        figures[EDGES] = error[picture.known & picture.at_edges].mean()
        figures[ELSEWHERE] = error[picture.known & ~picture.at_edges].mean()
    if step.mask:
        figures[MASK] = overlap(mask[clear], picture.truth[clear] <= THRESHOLD)
    return {measure: float(value) for measure, value in figures.items()}


def measure_options(sources: dict[str, np.ndarray], record: Record, seed: int) -> None:
    """Add what the options are worth that are off unless they are asked for."""
    makers: dict[str, Callable] = {
        "linear light, 8 bits": in_linear_light,
        "shot noise": with_shots,
    }
    for name, step in OPTIONS.items():
        found = defaultdict(list)
        for number, source in enumerate(sources.values()):
            seen = makers[name](middle(source), np.random.default_rng([seed, number]))
            for option in (STEPS[0], step):
                candidates = estimate_candidates(seen, **option.arguments(seen))
                found[option.name].append(
                    float(np.abs(label_blur_map(candidates, seen) - ramp()).mean())
                )
        for option, values in found.items():
            what = f"with an option: ramp, {name}"
            record.add(Number(what, "mean error", option, tuple(values), "px", "lower"))


def measure_search(sources: dict[str, np.ndarray], record: Record) -> None:
    """Add what the paper's own search for the maxima finds, and in what time."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for source in list(sources.values())[:SEARCHED]:
        seen = simulate_defocus(middle(source), ramp(), noise_variance=NOISE, rng=0)
        seen = middle(seen, SEARCHED_SIDE)
        truth = middle(ramp(), SEARCHED_SIDE)
        for search in ("lattice", "fixed-point"):
            began = time.perf_counter()
            candidates = estimate_candidates(seen, mode="paper", search=search)
            found["time", search].append(time.perf_counter() - began)
            error = np.abs(candidates.radii[..., 0] - at_windows(truth, candidates))
            found["median error", search].append(float(np.nanmedian(error)))
    for (measure, search), values in found.items():
        kind = ("s", "lower", "runs") if measure == "time" else ("px", "lower")
        record.add(Number("search for the maxima, 150 px", measure, search, tuple(values), *kind))


def in_linear_light(sharp: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    light = decode_srgb(sharp.astype(np.float32))
    blurred = simulate_defocus(light, ramp(), noise_variance=1e-6, rng=rng)
    return eight_bits(encode_srgb(blurred.clip(0, 1)))


def with_shots(sharp: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    blurred = simulate_defocus(sharp, ramp())
    variance = SHOT_GAIN * blurred.clip(0, 1) + READ_VARIANCE
    return (blurred + np.sqrt(variance) * rng.standard_normal(blurred.shape)).astype(np.float32)
