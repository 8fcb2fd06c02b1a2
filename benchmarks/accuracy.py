"""How far maps are from the truth on pictures of known blur, ours and those of peers.

A part of run_all.py. Scores without a unit become px by the monotone map of least error that the
truth of the other pictures of the same group gives, which is more than anybody has who uses them.
"""

from collections import defaultdict
from collections.abc import Iterable

import numpy as np
from measures import (
    RIGHT,
    THRESHOLD,
    MonotoneMap,
    area_under_roc,
    decided,
    overlap,
    rank_correlation,
    share_right,
)
from peers import SCORES, scores
from record import OURS, PAPER, Number, Record
from scenes import Group, Picture

from napari_defocus import (
    confidence_map,
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
)
from napari_defocus.settings import CONFIDENT

CONSTANT = "one radius for all"
SAYS_NINE_TENTHS = 0.85, 0.95
BINS = 10
_FIT_EVERY = 3
_RANK_EVERY = 2

MEASURES = {
    "mean error": ("px", "lower"),
    "median error": ("px", "lower"),
    "mean error where we are sure": ("px", "lower"),
    "mean error at edges": ("px", "lower"),
    "mean error elsewhere": ("px", "lower"),
    "in focus, intersection over union": ("", "higher"),
    "in focus, area under ROC": ("", "higher"),
    "rank correlation": ("", "higher"),
    "sure of": ("%", ""),
    "right where 0.9 is stated": ("%", ""),
}


def measure_accuracy(groups: Iterable[Group], record: Record) -> None:
    """Add the numbers of each group, and the calibration of the confidence over them."""
    bins: dict[str, np.ndarray] = defaultdict(lambda: np.zeros((BINS, 3)))
    for group in groups:
        pictures = list(group.make())
        found = [everything_of(picture) for picture in pictures]
        in_px(pictures, found)
        record.add(*numbers_of_group(group, pictures, found))
        if group.family == "uniform":
            record.add(*numbers_by_radius(pictures, found))
        for picture, maps in zip(pictures, found, strict=True):
            bins[kind_of(group)] += calibration_bins(picture, maps)
        print(f"{group.name}: {record.row(group.name, 'mean error')[OURS].shown()} px", flush=True)
    record.add(*calibration_numbers(bins))


def everything_of(picture: Picture) -> dict[str, np.ndarray]:
    """Return maps, masks, confidence and scores of one picture, each (H, W)."""
    candidates = estimate_candidates(picture.seen)
    blur_map = label_blur_map(candidates, picture.seen)
    plain = estimate_candidates(picture.seen, mode="paper")
    return {
        OURS: blur_map,
        PAPER: label_blur_map(plain, picture.seen),
        "confidence": confidence_map(candidates, blur_map),
        "mask": segment_in_focus(candidates, picture.seen, threshold=THRESHOLD) == 1,
        "mask of the paper": segment_in_focus(plain, picture.seen, threshold=THRESHOLD) == 1,
        **{f"score, {name}": score for name, score in scores(picture.seen).items()},
    }


def in_px(pictures: list[Picture], found: list[dict[str, np.ndarray]]) -> None:
    """Add maps in px that the scores give, fitted on all pictures of other sources."""
    some = np.s_[::_FIT_EVERY, ::_FIT_EVERY]
    for source in {picture.source for picture in pictures}:
        others = [at for at, picture in enumerate(pictures) if picture.source != source]
        known = [pictures[at].known[some] for at in others]
        truth = np.concatenate(
            [pictures[at].truth[some][k] for at, k in zip(others, known, strict=True)]
        )
        fits = {
            name: MonotoneMap.fitted(
                np.concatenate(
                    [found[at][f"score, {name}"][some][k]
                     for at, k in zip(others, known, strict=True)]
                ),
                truth,
            )
            for name in SCORES
        }  # fmt: skip
        for picture, maps in zip(pictures, found, strict=True):
            if picture.source == source:
                maps[CONSTANT] = np.full(picture.truth.shape, np.median(truth))
                for name, fit in fits.items():
                    maps[name] = fit(maps[f"score, {name}"])


def numbers_of_group(
    group: Group, pictures: list[Picture], found: list[dict[str, np.ndarray]]
) -> list[Number]:
    """Return all measures of a group, a value for each source."""
    sources = list(dict.fromkeys(picture.source for picture in pictures))
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for source in sources:
        of_source = [at for at, picture in enumerate(pictures) if picture.source == source]
        known = np.concatenate([pictures[at].known.ravel() for at in of_source])

        def flat(name: str, of_source: list = of_source, known: np.ndarray = known) -> np.ndarray:
            return np.concatenate([found[at][name].ravel() for at in of_source])[known]

        truth = np.concatenate([pictures[at].truth.ravel() for at in of_source])[known]
        at_edges = None
        if group.layered:
            at_edges = np.concatenate([pictures[at].at_edges.ravel() for at in of_source])[known]
        for method in (OURS, PAPER, *SCORES, CONSTANT):
            for measure, value in measures_of(method, flat, truth, at_edges).items():
                values[measure, method].append(value)
    return [
        Number(group.name, measure, method, tuple(each), *MEASURES[measure])
        for measure in MEASURES
        for (its, method), each in values.items()
        if its == measure and np.isfinite(each).any()
    ]


def measures_of(method: str, flat, truth: np.ndarray, at_edges: np.ndarray | None) -> dict:
    """Return what one method's map of one source is worth; `flat` returns its arrays."""
    error, stated, clear = np.abs(flat(method) - truth), flat("confidence"), decided(truth)
    sure = stated >= CONFIDENT
    masks = {OURS: "mask", PAPER: "mask of the paper"}
    mask = flat(masks[method]) if method in masks else flat(method) <= THRESHOLD
    some = np.s_[::_RANK_EVERY]
    score = flat(f"score, {method}" if method in SCORES else method)[some]
    measures = {
        "mean error": error.mean(),
        "median error": np.median(error),
        "mean error where we are sure": error[sure].mean() if sure.any() else np.nan,
        "in focus, intersection over union": overlap(mask[clear], truth[clear] <= THRESHOLD),
    }
    if at_edges is not None:
        measures["mean error at edges"] = error[at_edges].mean()
        measures["mean error elsewhere"] = error[~at_edges].mean()
    if method == CONSTANT:
        return measures
    measures |= {
        "in focus, area under ROC": area_under_roc(
            score[clear[some]], truth[some][clear[some]] > THRESHOLD
        ),
        "rank correlation": rank_correlation(score, truth[some]),
    }
    if method == OURS:
        measures["sure of"] = sure.mean()
        measures["right where 0.9 is stated"] = share_right(error, stated, *SAYS_NINE_TENTHS)
    return measures


def numbers_by_radius(pictures: list[Picture], found: list[dict]) -> list[Number]:
    """Return the mean error of each uniform radius."""
    values: dict[tuple[int, str], list[float]] = defaultdict(list)
    for picture, maps in zip(pictures, found, strict=True):
        radius = int(picture.truth.flat[0])
        for method in (OURS, PAPER, *SCORES):
            values[radius, method].append(float(np.abs(maps[method] - radius).mean()))
    return [
        Number(f"uniform, {radius} px", "mean error", method, tuple(each), "px", "lower")
        for (radius, method), each in values.items()
    ]


def kind_of(group: Group) -> str:
    """Name the kind of condition that the confidence is judged under."""
    if group.condition.startswith("noise"):
        return "noise"
    return group.condition.split()[0].rstrip(",")


def calibration_bins(picture: Picture, maps: dict[str, np.ndarray]) -> np.ndarray:
    """Return (count, sum of what is stated, count of what is right) of each tenth: (10, 3)."""
    stated = maps["confidence"][picture.known]
    right = np.abs(maps[OURS] - picture.truth)[picture.known] <= RIGHT
    place = np.minimum((BINS * stated).astype(int), BINS - 1)
    sums = [np.bincount(place, weights, BINS) for weights in (None, stated, right)]
    return np.stack(sums, axis=1)


def calibration_numbers(bins: dict[str, np.ndarray]) -> list[Number]:
    """Return the confidence's calibration: right against stated, and the mean difference."""
    numbers = []
    for kind, sums in bins.items():
        count, stated, right = sums.T
        difference = np.abs(stated - right).sum() / count.sum()
        what = f"confidence, {kind}"
        numbers.append(Number(what, "mean difference from what is right", OURS,
                              (difference,), "%", "lower"))  # fmt: skip
        for place in np.flatnonzero(count >= 1000):
            says = f"stated {stated[place] / count[place]:.2f}"
            numbers.append(Number(what, says, OURS, (right[place] / count[place],), "%"))
    return numbers
