from dataclasses import replace

import dask.array as da
import numpy as np
import pytest
from napari.layers import Image

import napari_defocus
from napari_defocus import Disc, RestorationFit
from napari_defocus.settings import MapSettings, RefocusSettings, RestorationSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.map_source import EstimatedSource, source_of_layer
from napari_defocus.widgets.jobs.restoration import Refocusing, Restoration
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

PLACED = {
    "scale": (0.5, 0.25),
    "translate": (3.0, -4.0),
    "rotate": 20.0,
    "units": ("um", "um"),
    "axis_labels": ("y", "x"),
}


@pytest.fixture
def leaf(viewer, texture):
    return viewer.add_image(texture, name="leaf", **PLACED)


def restoration(viewer, layer, *, map_layer=None, linearize=None, protect=True, **settings):
    plane = shown_plane(layer, viewer.dims)
    return Restoration(
        plane=plane,
        source=EstimatedSource(settings=MapSettings())
        if map_layer is None
        else source_of_layer(map_layer, plane, viewer, "disc"),
        settings=RestorationSettings(**settings),
        linearize=linearize,
        protect=protect,
    )


def refocusing(viewer, layer, view, **options):
    return Refocusing(restoration=restoration(viewer, layer, **options), view=view)


def test_picture_all_in_focus_lies_on_the_picture_above_its_map(viewer, leaf, method):
    results = restoration(viewer, leaf).run(JobCache())
    *_, sharp = add_results(viewer, results.layers)
    names = [layer.name for layer in viewer.layers]
    assert names == ["leaf", "leaf blur (px)", "leaf confidence", "leaf all in focus"]
    assert sharp.data.dtype == np.float32
    assert (sharp.data == 0.25).all()
    assert tuple(sharp.contrast_limits) == (0.0, 1.0)
    assert not sharp.colorbar.visible
    for corner in np.ndindex(2, 2):
        np.testing.assert_allclose(sharp.data_to_world(corner), leaf.data_to_world(corner))
    assert sharp.units == leaf.units
    assert sharp.axis_labels == ("y", "x")
    made = sharp.metadata[METADATA_KEY]
    assert (made["result"], made["source"]) == ("all in focus", "leaf")
    assert made["blur_map"] == "leaf blur (px)"
    assert made["settings"]["map"]["psf"] == "disc"
    assert made["settings"]["restoration"]["tv_weight"] is None
    assert made["noise_variance"] > 0
    assert "(found)" in results.summary


@pytest.mark.parametrize("refocused", [False, True])
def test_what_is_left_as_it_was_is_a_veil_over_the_picture_if_asked_for(
    viewer, leaf, method, refocused
):
    asked = replace(restoration(viewer, leaf), show_left=True)
    if refocused:
        asked = Refocusing(restoration=asked, view=RefocusSettings(focus=2.0))
    results = asked.run(JobCache())
    *_, veil = add_results(viewer, results.layers)
    assert veil is viewer.layers[-1]
    assert veil.name == "leaf left as it was"
    assert (veil.data == 0.125).all()
    assert veil.colormap.map(np.array([0.0, 1.0]))[:, 3] == pytest.approx([0.0, 0.6], abs=0.01)
    np.testing.assert_allclose(veil.data_to_world((3, 4)), leaf.data_to_world((3, 4)))
    assert "12% of the picture was left as it was" in results.summary


def test_a_veil_over_nothing_is_said_to_be_one(viewer, leaf, method, monkeypatch):
    fit = RestorationFit(1e-5, 2e-3, 0.0, np.zeros(leaf.data.shape, np.float32))
    sharp = np.full(leaf.data.shape, 0.25, np.float32)
    monkeypatch.setitem(vars(napari_defocus), "restore_all_in_focus", lambda *_, **__: (sharp, fit))
    said = "Less than 1% of the picture was left as it was."
    for asked in (True, False):
        results = replace(restoration(viewer, leaf), show_left=asked).run(JobCache())
        assert (said in results.summary) == asked


def test_what_the_blur_map_widget_has_estimated_is_used(viewer, leaf, method):
    cache = JobCache()
    Analysis(plane=shown_plane(leaf, viewer.dims), estimation=MapSettings()).run(cache)
    restoration(viewer, leaf).run(cache)
    assert len(method.estimations) == 1


@pytest.mark.parametrize("misfit", [0.0, 7e-5])
def test_summary_says_so_if_the_picture_does_not_fit_its_map(viewer, leaf, method, misfit):
    method.misfit = misfit
    results = restoration(viewer, leaf).run(JobCache())
    assert ("may not fit this picture" in results.summary) == (misfit > 0)


def test_settings_reach_the_method(viewer, leaf, method):
    cache = JobCache()
    restoration(viewer, leaf, linearize="srgb", noise_variance=1e-4, tv_weight=2e-3).run(cache)
    [call] = method.restorations
    assert call["psf"] == Disc()
    assert call["linearize"] == "srgb"
    assert call["noise_variance"] == 1e-4
    assert call["tv_weight"] == 2e-3
    assert call["confidence"].max() == 1
    assert (call["blur_map"] < method.radius).all()


@pytest.mark.parametrize("protect", [True, False])
def test_uncertain_places_are_protected_if_it_is_wanted(viewer, leaf, method, protect):
    results = restoration(viewer, leaf, protect=protect).run(JobCache())
    [call] = method.restorations
    assert (call["confidence"] is not None) == protect
    assert (call["blur_map"] < method.radius).all() == protect
    assert len(results.layers) == 3


def test_map_of_a_layer_is_taken_as_it_is_now(viewer, leaf, method):
    theirs = viewer.add_image(np.full(leaf.data.shape, 3.0), name="theirs")
    cache = JobCache()
    wanted = restoration(viewer, leaf, map_layer=theirs)
    results = wanted.run(cache)
    assert not method.estimations
    assert (method.restorations[0]["blur_map"] == 3.0).all()
    assert method.restorations[0]["confidence"] is None
    assert [keywords["name"] for _, keywords, _ in results.layers] == ["leaf all in focus"]
    assert "Nothing is protected" in results.summary
    theirs.data[5, 5] = 1.0
    wanted.run(cache)
    assert method.restorations[1]["blur_map"][5, 5] == 1.0


def test_map_of_ours_is_protected_until_somebody_changes_it(viewer, leaf, method):
    cache = JobCache()
    run = Analysis(plane=shown_plane(leaf, viewer.dims), estimation=MapSettings()).run(cache)
    blur_map = Image(run[0][0], **run[0][1])
    viewer.add_layer(blur_map)
    wanted = restoration(viewer, leaf, map_layer=blur_map)
    wanted.run(cache)
    assert (method.restorations[0]["blur_map"] < method.radius).all()
    blur_map.data[5, 5] = 1.0
    wanted.run(cache)
    assert method.restorations[1]["blur_map"][5, 5] == 1.0


def test_another_view_of_the_same_picture_only_blurs_it_again(viewer, leaf, method):
    cache = JobCache()
    for focus, aperture, side in ((0, 1, "far"), (3, 2, "near"), (4, 0, "far")):
        view = RefocusSettings(focus=focus, aperture=aperture, side=side, linearize=None)
        refocusing(viewer, leaf, view).run(cache)
    assert len(method.restorations) == len(method.labelings) == 1
    told = [(call["focus"], call["aperture"], call["side"]) for call in method.refocusings]
    assert told == [(0, 1, "far"), (3, 2, "near"), (4, 0, "far")]
    for call in method.refocusings:
        assert (call["all_in_focus"] == 0.25).all()


def test_what_is_made_all_in_focus_can_be_seen_with_another_focus(viewer, leaf, method):
    cache = JobCache()
    restoration(viewer, leaf).run(cache)
    refocusing(viewer, leaf, RefocusSettings(focus=2, linearize=None)).run(cache)
    assert len(method.restorations) == 1


@pytest.mark.parametrize(
    "changed", [{"tv_weight": 1e-3}, {"linearize": "srgb"}, {"protect": False}]
)
def test_other_settings_restore_again(viewer, leaf, method, changed):
    cache = JobCache()
    restoration(viewer, leaf).run(cache)
    restoration(viewer, leaf, **changed).run(cache)
    assert len(method.restorations) == 2


def test_edited_picture_is_restored_again(viewer, leaf, method):
    cache, wanted = JobCache(), restoration(viewer, leaf)
    wanted.run(cache)
    leaf.data[10, 10] = 0
    wanted.run(cache)
    assert len(method.restorations) == 2


def test_painting_on_the_result_does_not_change_what_is_kept(viewer, leaf, method):
    cache = JobCache()
    add_results(viewer, restoration(viewer, leaf).run(cache).layers)[-1].data[:] = 1
    refocusing(viewer, leaf, RefocusSettings(linearize=None)).run(cache)
    assert method.refocusings[0]["all_in_focus"].max() == 0.25


def test_another_focus_updates_its_layer_and_leaves_the_map_alone(viewer, leaf, method):
    cache = JobCache()
    for focus in (2.0, 4.0):
        view = RefocusSettings(focus=focus)
        layers = add_results(viewer, refocusing(viewer, leaf, view).run(cache).layers)
        assert layers[-1].name == "leaf refocused"
        assert layers[-1].data.max() == np.float32(focus / 10)
        layers[0].contrast_limits = (1, 3)
        layers[-1].contrast_limits = (0.1, 0.9)
    assert len(viewer.layers) == 4
    assert tuple(layers[-1].contrast_limits) == (0.1, 0.9)
    assert tuple(viewer.layers["leaf blur (px)"].contrast_limits) == (1, 3)
    assert layers[-1].metadata[METADATA_KEY]["settings"]["view"]["focus"] == 4.0


@pytest.mark.parametrize("channels", [3, 4])
def test_colour_stays_colour(viewer, method, channels):
    color = np.random.default_rng(0).random((32, 48, channels), np.float32)
    layer = viewer.add_image(color, name="color")
    *_, sharp = add_results(viewer, restoration(viewer, layer).run(JobCache()).layers)
    assert sharp.rgb
    assert sharp.data.shape == (32, 48, 3)


def test_color_bar_of_a_map_does_not_stay_over_the_restored_picture(viewer, leaf, method):
    results = restoration(viewer, leaf).run(JobCache())
    blur_map, confidence, _ = results.layers
    blur_map[1]["visible"] = True
    shown, _ = add_results(viewer, [blur_map, confidence])
    assert shown.visible
    *_, sharp = add_results(viewer, results.layers)
    assert sharp.visible
    assert not [layer.name for layer in viewer.layers if layer.visible and layer.colorbar.visible]
    shown.visible = True
    add_results(viewer, results.layers)
    assert shown.visible, "once it is there, its user shows and hides it"


def test_grey_picture_takes_the_place_of_a_colour_picture_of_its_name(viewer, method, texture):
    layer = viewer.add_image(np.dstack([texture] * 3), name="leaf")
    add_results(viewer, restoration(viewer, layer).run(JobCache()).layers)
    viewer.layers.remove(layer)
    layer = viewer.add_image(texture, name="leaf")
    *_, sharp = add_results(viewer, restoration(viewer, layer).run(JobCache()).layers)
    assert not sharp.rgb
    assert sharp.name == "leaf all in focus"
    assert sharp.data.shape == texture.shape


def test_of_a_stack_the_plane_that_is_shown(viewer, method):
    stack = np.random.default_rng(0).random((4, 32, 48, 3))
    layer = viewer.add_image(stack, scale=(5, 1, 1))
    viewer.dims.set_current_step(0, 2)
    *_, sharp = add_results(viewer, restoration(viewer, layer).run(JobCache()).layers)
    np.testing.assert_array_equal(method.restorations[0]["image"], stack[2])
    assert sharp.data.shape == (1, 32, 48, 3)
    assert tuple(sharp.data_to_world((0, 0, 0))) == (10, 0, 0)


def test_of_several_scales_and_of_dask_the_finest(viewer, method, texture):
    lazy = da.from_array(texture, chunks=40)
    layer = viewer.add_image([lazy, lazy[::2, ::2]])
    *_, sharp = add_results(viewer, restoration(viewer, layer).run(JobCache()).layers)
    assert sharp.data.shape == texture.shape
    np.testing.assert_array_equal(method.restorations[0]["image"], texture)


def test_12_bit_data_in_uint16_are_shown_as_the_layer_shows_them(viewer, method):
    data = np.random.default_rng(0).integers(0, 4096, (32, 48)).astype(np.uint16)
    layer = viewer.add_image(data, contrast_limits=(0, 4095))
    found = refocusing(viewer, layer, RefocusSettings()).run(JobCache())
    for call in (*method.estimations, *method.restorations, *method.refocusings):
        assert call.get("intensity_range") is None
    assert found.layers[-1][1]["contrast_limits"] == pytest.approx((0, 4095 / 65535))


def test_pixels_without_a_value_are_refused_before_any_work(viewer, leaf, method):
    leaf.data[3, 4] = np.inf
    with pytest.raises(NotAnalysableError, match="infinite"):
        restoration(viewer, leaf).run(JobCache())
    assert not method.estimations


def test_progress_rises_from_0_to_1(viewer, leaf, method):
    seen = []
    wanted = refocusing(viewer, leaf, RefocusSettings())
    wanted.run(JobCache(), lambda step, done: seen.append(done))
    assert seen == sorted(seen)
    assert 0.0 <= seen[0] <= seen[-1] <= 1.0


def test_same_work_is_told_from_other_work(viewer, leaf, method):
    assert restoration(viewer, leaf) == restoration(viewer, leaf)
    assert restoration(viewer, leaf) != restoration(viewer, leaf, protect=False)
    before = restoration(viewer, leaf)
    leaf.data = leaf.data.copy()
    assert restoration(viewer, leaf) != before
