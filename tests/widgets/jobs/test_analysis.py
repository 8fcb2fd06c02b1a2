import numpy as np
import pytest
from napari.components import ViewerModel
from scipy.ndimage import uniform_filter1d

from napari_defocus import (
    Annulus,
    Polygon,
    ShotNoise,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
    simulate_defocus,
)
from napari_defocus.core.progress import silent
from napari_defocus.core.worker_process import run_elsewhere
from napari_defocus.labeling.problem import with_problem
from napari_defocus.settings import COMPARED_PSFS, MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.jobs import estimation
from napari_defocus.widgets.jobs.analysis import Analysis, Comparison
from napari_defocus.widgets.jobs.estimation import JobCache, Picture
from napari_defocus.widgets.jobs.map_source import source_of_layer
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY


@pytest.fixture
def layer(texture):
    return ViewerModel().add_image(texture, name="leaf")


@pytest.fixture
def viewer():
    return ViewerModel()


def analysis(viewer, layer, *, threshold=None, blur_map=True, **estimation):
    return Analysis(
        plane=shown_plane(layer, viewer.dims),
        estimation=MapSettings(**estimation),
        mask=None if threshold is None else MaskSettings(threshold=threshold),
        blur_map=blur_map,
    )


def test_another_threshold_does_not_estimate_again(viewer, layer, method):
    cache = JobCache()
    [dim] = analysis(viewer, layer, threshold=2.0, blur_map=False).run(cache)
    [lit] = analysis(viewer, layer, threshold=3.0, blur_map=False).run(cache)
    assert len(method.estimations) == 1
    assert (dim[0] == 0).all()
    assert (lit[0] == 1).all()


def test_mask_reuses_what_the_map_has_found(viewer, layer, method):
    cache = JobCache()
    analysis(viewer, layer).run(cache)
    analysis(viewer, layer, smoothness=3.0).run(cache)
    analysis(viewer, layer, threshold=2.0, blur_map=False).run(cache)
    assert len(method.estimations) == 1


@pytest.mark.parametrize(
    "changed",
    [
        {"max_radius": 5.0},
        {"noise_variance": 1e-4},
        {"psf": "annulus:0.5"},
        {"linearize": "srgb"},
        {"shot_noise": True},
    ],
)
def test_other_estimation_settings_estimate_again(viewer, layer, method, changed):
    cache = JobCache()
    analysis(viewer, layer).run(cache)
    analysis(viewer, layer, **changed).run(cache)
    assert len(method.estimations) == 2


def test_edited_picture_is_estimated_again(viewer, layer, method):
    cache = JobCache()
    analysis(viewer, layer).run(cache)
    layer.data[10, 10] = 0.0
    analysis(viewer, layer).run(cache)
    layer.data = np.flip(layer.data, axis=0)
    analysis(viewer, layer).run(cache)
    assert len(method.estimations) == 3


def test_settings_reach_the_method(viewer, layer, method):
    analysis(
        viewer, layer, threshold=1.2, max_radius=5.0, noise_variance=2e-5, color_sigma=0.3
    ).run(JobCache())
    [estimation] = method.estimations
    assert estimation["psf"].max_radius == 5.0
    assert estimation["noise_variance"] == 2e-5
    assert method.labelings[0]["color_sigma"] == 0.3
    assert method.estimations[0]["mode"] == MapSettings.mode
    assert method.segmentations[0]["threshold"] == 1.2
    assert method.segmentations[0]["smoothness"] == MaskSettings.smoothness


def test_lens_light_and_noise_reach_the_method(viewer, layer, method):
    analysis(viewer, layer, psf="polygon:5", linearize="srgb", shot_noise=True).run(JobCache())
    [estimation] = method.estimations
    assert estimation["psf"] == Polygon(5)
    assert estimation["linearize"] == method.noises[0]["linearize"] == "srgb"
    assert estimation["noise_variance"] == ShotNoise(1e-5, 1e-4)


@pytest.mark.parametrize(("confidence", "names"), [(True, ["leaf confidence"]), (False, [])])
def test_confidence_comes_with_the_map_if_it_is_wanted(viewer, layer, method, confidence, names):
    wanted = Analysis(
        plane=shown_plane(layer, viewer.dims), estimation=MapSettings(), confidence=confidence
    )
    layers = wanted.run(JobCache())
    assert [keywords["name"] for _, keywords, _ in layers] == ["leaf blur (px)", *names]


def test_lens_and_threshold_that_cannot_be_are_refused_before_any_work(viewer, layer, method):
    with pytest.raises(ValueError, match="no such file"):
        analysis(viewer, layer, psf="none.npz")
    with pytest.raises(ValueError, match="below 8 px"):
        analysis(viewer, layer, psf="gaussian", max_radius=8.0, threshold=8.5)
    with pytest.raises(ValueError, match=r"below (8|16|32) px"):  # as far as this picture tells
        analysis(viewer, layer, psf="gaussian", threshold=63.0)
    assert not method.estimations


def test_comparison_has_the_lens_of_the_form_too_and_the_right_one_first(viewer, gravel):
    radius = np.full(gravel.shape, 5.0)
    seen = simulate_defocus(gravel, radius, psf=Annulus(0.5), noise_variance=1e-6, rng=0)
    plane = shown_plane(viewer.add_image(seen.astype(np.float32)), viewer.dims)
    settings = MapSettings(psf="annulus:0.7")
    rows = Comparison(plane=plane, estimation=settings).run()
    assert {text for text, _ in rows} == {*COMPARED_PSFS, "annulus:0.7"}
    assert rows[0][0] == "annulus:0.5"
    assert rows[0][1].median_scale == pytest.approx(5, abs=0.2)


def test_layers_say_that_a_picture_does_not_look_like_defocus(viewer, gravel):
    moving = uniform_filter1d(gravel, 13, axis=1, mode="mirror")
    image = viewer.add_image(moving.astype(np.float32), name="moving")
    for _, keywords, _ in analysis(viewer, image, threshold=2.0).run(JobCache()):
        assert "motion" in keywords["metadata"][METADATA_KEY]["doubt"]
    still = viewer.add_image(gravel.astype(np.float32), name="still")
    for _, keywords, _ in analysis(viewer, still, threshold=2.0).run(JobCache()):
        assert "doubt" not in keywords["metadata"][METADATA_KEY]


def test_lens_that_the_picture_shows_is_that_of_its_layers(viewer, gravel):
    radius = np.full(gravel.shape, 5.0)
    seen = simulate_defocus(gravel, radius, psf=Annulus(0.5), noise_variance=1e-6, rng=0)
    image, cache = viewer.add_image(seen.astype(np.float32), name="ring"), JobCache()
    wanted = analysis(viewer, image, psf="auto", threshold=2.0)
    layers = wanted.run(cache)
    for _, keywords, _ in layers:
        made = keywords["metadata"][METADATA_KEY]
        assert made["settings"]["psf"] == "annulus:0.5"
        assert made["lens"] == "Lens: annulus:0.5, found from the picture"
    assert wanted.fits(cache.analysed.latest(image)), "sliders do not estimate again"
    blur_map = add_results(viewer, layers)[0]
    source = source_of_layer(blur_map, wanted.plane, viewer, "disc")
    found = source.read(Picture.of(wanted.plane), cache, silent)
    assert found.psf == Annulus(0.5)
    assert found.safe is not None, "what is safe to take away is still known"


def test_planes_of_a_stack_share_the_lens_that_they_show(viewer, gravel):
    sharp, radius = gravel[:100, :100], np.full((100, 100), 4.0)
    ring = simulate_defocus(sharp, radius, psf=Annulus(0.5), noise_variance=1e-6, rng=0)
    stack = viewer.add_image(np.stack([ring, sharp, ring[::-1]]).astype(np.float32), name="worm")
    wanted = StackAnalysis(
        plane=shown_plane(stack, viewer.dims), estimation=MapSettings(psf="auto", stride=8)
    )
    found = wanted.run(JobCache())
    assert found.summary.startswith("Lens: annulus:0.5, found from the picture\n3 planes")
    assert found.layers[0][1]["metadata"][METADATA_KEY]["settings"]["psf"] == "annulus:0.5"


def test_what_is_measured_does_not_depend_on_contrast_limits(viewer, method):
    data = np.random.default_rng(0).integers(0, 4096, (32, 48)).astype(np.uint16)
    layer = viewer.add_image(data, contrast_limits=(0, 4095))
    analysis(viewer, layer, threshold=2.0).run(JobCache())
    for call in (method.estimations[0], method.labelings[0], method.segmentations[0]):
        assert call.get("intensity_range") is None


def test_large_pictures_are_worked_on_in_another_process_with_the_same_result(viewer, monkeypatch):
    picture = np.random.default_rng(0).uniform(0, 1, (48, 64, 3)).astype(np.float32)
    layer = viewer.add_image(picture, rgb=True)
    elsewhere = set()

    def spy(function, *args, **keywords):
        work = args[0] if function is with_problem else function
        elsewhere.add(work.__name__)
        return run_elsewhere(function, *args, **keywords)

    monkeypatch.setattr(estimation, "run_elsewhere", spy)
    here = analysis(viewer, layer, threshold=2.0).run(JobCache())
    assert not elsewhere
    monkeypatch.setattr(estimation, "LARGE", picture[..., 0].size - 1)
    there = analysis(viewer, layer, threshold=2.0).run(JobCache())
    assert elsewhere == {
        *("measure_candidates", "labeled_blur_map", "confidence_of_problem", "labeled_mask"),
    }
    for (data, keywords, kind), (same_data, same_keywords, same_kind) in zip(
        here, there, strict=True
    ):
        np.testing.assert_array_equal(data, same_data)
        assert (keywords["name"], kind) == (same_keywords["name"], same_kind)


def test_progress_rises_from_0_to_1(viewer, layer, method):
    seen = []
    analysis(viewer, layer, threshold=2.0).run(JobCache(), lambda step, done: seen.append(done))
    assert seen == sorted(seen)
    assert 0.0 <= seen[0] <= seen[-1] <= 1.0


def test_floats_of_any_range_are_measured_as_in_a_script_whatever_the_contrast_limits(
    viewer, texture
):
    image = (255.5 * texture).astype(np.float32)
    layer = viewer.add_image(image, contrast_limits=(40, 41))
    blur_map, confidence, mask = analysis(viewer, layer, threshold=2.0).run(JobCache())
    candidates = estimate_candidates(image)
    expected = label_blur_map(candidates, image)
    np.testing.assert_array_equal(blur_map[0], expected)
    np.testing.assert_array_equal(confidence[0], confidence_map(candidates, expected))
    np.testing.assert_array_equal(mask[0], segment_in_focus(candidates, image))
    for _, keywords, _ in (blur_map, confidence, mask):
        told = keywords["metadata"][METADATA_KEY]["intensities"]
        assert told == candidates.intensities.facts()
        assert told["intensities_from"] == "picture"
