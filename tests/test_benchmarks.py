"""What the benchmarks compute themselves: fits, areas, and what counts as better or worse."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(autouse=True)
def _scripts_are_found(monkeypatch):
    if not BENCHMARKS.is_dir():
        pytest.skip("the benchmarks are not shipped")
    monkeypatch.syspath_prepend(BENCHMARKS)
    yield
    for name in ("measures", "record"):
        sys.modules.pop(name, None)


def number(values, **changes):
    from record import OURS, Number

    first = Number("ramp, noise 1e-06", "mean error", OURS, tuple(values), "px", "lower")
    return replace(first, **changes)


def test_monotone_map_undoes_any_growing_score():
    from measures import MonotoneMap

    truth = np.random.default_rng(0).uniform(0, 8, 20000)
    fitted = MonotoneMap.fitted(np.exp(truth), truth)
    assert np.abs(fitted(np.exp(truth)) - truth).mean() < 0.05


def test_monotone_map_of_chance_is_the_median_and_never_falls():
    from measures import MonotoneMap

    rng = np.random.default_rng(0)
    truth, score = rng.exponential(2, 20000), rng.standard_normal(20000)
    fitted = MonotoneMap.fitted(score, truth)
    assert (np.diff(fitted.radius) >= 0).all()
    assert np.abs(fitted(score) - truth).mean() == pytest.approx(
        np.abs(np.median(truth) - truth).mean(), rel=0.01
    )


def test_area_under_roc_counts_pairs_in_order():
    from measures import area_under_roc

    positive = np.array([False, True, False, True])
    assert area_under_roc(np.array([1, 2, 3, 4]), positive) == 0.75
    assert area_under_roc(np.zeros(4), positive) == 0.5
    assert np.isnan(area_under_roc(np.zeros(4), np.ones(4, bool)))


@pytest.mark.parametrize(
    ("before", "after", "better", "verdict"),
    [
        ((0.1, 0.5, 0.9), (0.09, 0.45, 0.8), "lower", "better"),
        ((0.1, 0.5, 0.9), (0.2, 0.6, 1.0), "lower", "worse"),
        ((0.1, 0.5, 0.9), (0.2, 0.6, 1.0), "higher", "better"),
        ((0.1, 0.5, 0.9), (0.9, 0.1, 0.5), "lower", "the same"),
        ((0.1, 0.5, 0.9), (0.1, 0.5, 0.901), "lower", "the same"),
        ((0.1, 0.5, 0.9), (np.nan, np.nan, np.nan), "lower", "new"),
    ],
)
def test_pictures_are_compared_one_by_one(before, after, better, verdict):
    from record import verdict_on

    assert verdict_on(number(before), number(after, better=better)) == verdict


def test_times_that_overlap_are_the_same():
    from record import verdict_on

    was = number((1.0, 1.2, 1.4), kind="runs")
    assert verdict_on(was, number((1.1, 1.3, 1.5), kind="runs")) == "the same"
    assert verdict_on(was, number((2.1, 2.3, 2.5), kind="runs")) == "worse"


def test_what_is_stored_is_read_again_and_compared(tmp_path):
    from record import Record, compared

    stored = Record({"accuracy": {"seed": 0}}, [number((0.1, np.nan, 0.9))])
    path = tmp_path / "numbers.json"
    path.write_bytes(stored.as_json())
    again = Record.read(path)
    np.testing.assert_equal(again.numbers, stored.numbers)
    assert "1 worse" in compared(again, Record({}, [number((0.2, np.nan, 1.0))]))
    assert "accuracy: seed" in compared(again, Record({"accuracy": {"seed": 1}}, []))


def test_parts_that_are_measured_again_take_the_place_of_their_own_only():
    from record import Record

    def record(part, seed):
        found = Record({part: {"seed": seed}}, part=part)
        found.add(number((seed,), what=part))
        return found

    earlier = record("sizes", 1)
    earlier.keep_others_of(record("accuracy", 1))
    again = record("sizes", 2)
    again.keep_others_of(earlier)
    assert {n.part: n.values for n in again.numbers} == {"sizes": (2,), "accuracy": (1,)}
    assert again.made == {"sizes": {"seed": 2}, "accuracy": {"seed": 1}}


def test_the_best_as_shown_is_bold(tmp_path):
    from record import OURS, Record, table

    what, measure = "ramp, noise 1e-06", "mean error"
    record = Record({}, [number((0.1001,)), number((0.1002,), method="peer")])
    record.add(number((0.3,), method="another"))
    row = table(record, [(what, measure)], (OURS, "peer")).splitlines()[-1]
    assert row == f"| {what} | {measure}, px | **0.100** | **0.100** | another 0.300 |"
