import time

import numpy as np
import pytest

import napari_defocus
from napari_defocus import Annulus, GeneralizedGaussian, ShotNoise, simulate_defocus
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.docks.change_focus import ChangeFocusWidget
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.forms.image_panel import ImagePanel

pytestmark = pytest.mark.display

MADE = ["leaf blur (px)", "leaf confidence", "leaf in focus", "leaf not trusted"]


def names(viewer):
    return [layer.name for layer in viewer.layers]


def test_widget_makes_its_layers(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf", scale=(2, 3), units=("um", "um"), axis_labels=("y", "x"))
    finish(opened(DefocusWidget))
    assert names(viewer) == ["leaf", *MADE]
    for layer in list(viewer.layers)[1:]:
        assert tuple(layer.scale) == (2, 3)
        assert [str(unit) for unit in layer.units] == ["micrometer", "micrometer"]
        assert layer.axis_labels == ("y", "x")
        assert layer.metadata["napari_defocus"]["noise_variance"] == method.noise_variance


def test_colour_bar_of_the_map_is_shown(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    finish(opened(DefocusWidget))
    blur_map = viewer.layers["leaf blur (px)"]
    assert blur_map.colorbar.visible
    assert tuple(blur_map.contrast_limits) == (0.0, 8.0)


def test_form_starts_with_the_defaults_of_the_method(viewer, opened):
    settings = opened(DefocusWidget).settings
    assert settings.map_settings() == MapSettings()
    assert settings.mask_settings() == MaskSettings()


def test_every_field_explains_itself(viewer, opened):
    widget = opened(DefocusWidget)
    for field in (widget.image, widget.seeds, widget.seeds_button, *widget.settings.fields()):
        assert len(field.tooltip) > 40


def test_form_reaches_the_method(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    widget.settings.noise_variance.value = "1e-4"
    widget.settings.max_radius.value = 5
    widget.settings.threshold.value = 3
    finish(widget)
    assert method.estimations[0]["noise_variance"] == 1e-4
    assert method.segmentations[0]["threshold"] == 3
    assert method.estimations[0]["psf"].max_radius == 5
    blur_map = viewer.layers["leaf blur (px)"]
    assert blur_map.metadata["napari_defocus"]["settings"]["max_radius"] == 5
    assert tuple(blur_map.contrast_limits) == (0.0, 8.0)


def test_lens_light_and_noise_of_the_form_reach_the_method(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    widget.settings.lens.take("generalized-gaussian:4")
    widget.settings.linear_light.value = True
    widget.settings.noise_variance.value = "nonsense that has no say"
    widget.settings.shot_noise.value = True
    assert not widget.settings.noise_variance.enabled
    finish(widget)
    [estimation] = method.estimations
    assert estimation["psf"] == GeneralizedGaussian(4.0, 64.0)
    assert estimation["linearize"] == "srgb"
    assert estimation["noise_variance"] == ShotNoise(1e-5, 1e-4)
    assert tuple(viewer.layers["leaf blur (px)"].contrast_limits) == (0.0, 8.0)


def test_no_confidence_layer_if_it_is_not_wanted(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    widget.settings.confidence.value = False
    assert not widget.settings.min_confidence.enabled
    finish(widget)
    assert names(viewer) == ["leaf", "leaf blur (px)", "leaf in focus"]


def test_hiding_what_is_not_trusted_does_not_estimate_again(
    viewer, opened, finish, method, texture
):
    viewer.add_image(texture, name="leaf", scale=(2, 3))
    widget = opened(DefocusWidget)
    widget.settings.min_confidence.value = 0.25
    assert names(viewer) == ["leaf"], "there is nothing to hide yet"
    finish(widget)
    cover = viewer.layers["leaf not trusted"]
    confidence = viewer.layers["leaf confidence"].data
    assert 0 <= confidence.min() <= confidence.max() <= 1
    for limit in (0.25, 0.75, 0.0):
        widget.settings.min_confidence.value = limit
        np.testing.assert_array_equal(cover.data, confidence < limit)
    assert tuple(cover.scale) == (2, 3)
    assert len(method.estimations) == len(method.labelings) == 1
    assert len(viewer.layers) == 5


def test_cover_is_of_the_newest_of_several_results(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    widget.settings.min_confidence.value = 0.25
    finish(widget)
    cover, sure = viewer.layers["leaf not trusted"], viewer.layers["leaf confidence"]
    data, keywords, kind = sure.as_layer_data_tuple()
    keywords["name"] = "leaf confidence"
    add_results(viewer, [(1 - data, keywords, kind)], keep_earlier=True)
    for limit in (0.25, 0.5):
        widget.settings.min_confidence.value = limit
        widget.settings.min_confidence.changed.emit(limit)
        np.testing.assert_array_equal(cover.data, 1 - data < limit)
    np.testing.assert_array_equal(sure.data, data)
    assert names(viewer)[-1] == "leaf confidence 2"


def test_nothing_is_covered_if_it_is_not_wanted(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    assert widget.settings.min_confidence.value == 0.5
    widget.settings.min_confidence.value = 0.0
    finish(widget)
    assert "leaf not trusted" not in names(viewer)


def test_only_the_fields_that_the_lens_needs_are_shown(viewer, opened):
    lens = opened(DefocusWidget).settings.lens
    for name, needed in {
        "disc": [],
        "polygon": [lens.blades, lens.rotation],
        "annulus": [lens.obstruction],
        "gaussian": [],
        "generalized-gaussian": [lens.exponent],
        "measured": [lens.file],
    }.items():
        lens.lens.value = name
        shown = [field for field in lens.fields()[1:] if not field.native.isHidden()]
        assert shown == needed


def test_more_settings_are_hidden_until_they_are_asked_for(viewer, opened):
    settings = opened(ChangeFocusWidget).settings
    for shown in (False, True, False):
        hidden = {field.native.isHidden() for field in settings.more_fields()}
        assert hidden == {not shown}
        assert not settings.max_radius.native.isHidden()
        settings.more.native.click()


def test_which_lens_fits_is_shown_and_taken(viewer, opened, qtbot, gravel):
    radius = np.full(gravel.shape, 5.0)
    seen = simulate_defocus(gravel, radius, psf=Annulus(0.5), noise_variance=1e-6, rng=0)
    viewer.add_image(seen.astype(np.float32), name="gravel")
    viewer.add_image(gravel, name="other")
    widget = opened(DefocusWidget)
    widget.image.value = viewer.layers["gravel"]
    assert widget.comparison.best_button.native.isHidden()
    with qtbot.waitSignal(widget.compare().finished):
        assert not widget.comparison.button.enabled
        assert not widget.run_button.enabled
    assert widget.comparison.button.enabled
    table = widget.comparison.table.value
    assert table.index("annulus:0.5") < table.index("annulus:0.3") < table.index("disc")
    assert "5.0 px" in table
    assert widget.comparison.best_button.text == "Take the best: annulus:0.5"
    widget.comparison.best_button.native.click()
    assert widget.settings.map_settings().psf == "annulus:0.5"
    assert names(viewer) == ["gravel", "other"]
    widget.image.value = viewer.layers["other"]
    assert widget.comparison.best_button.native.isHidden(), "it was about another picture"


def test_comparison_of_a_picture_without_texture_is_said_in_plain_words(
    viewer, opened, qtbot, messages
):
    viewer.add_image(np.zeros((60, 60), np.uint8), name="black")
    widget = opened(DefocusWidget)
    with qtbot.waitSignal(widget.compare().finished):
        pass
    assert "no texture" in messages()[0]
    assert widget.comparison.best_button.native.isHidden()


def test_measured_lens_without_a_file_is_said_in_plain_words(viewer, opened, texture, messages):
    viewer.add_image(texture)
    widget = opened(DefocusWidget)
    widget.settings.lens.lens.value = "measured"
    assert widget.run() is None
    assert widget.compare() is None
    assert messages()[0] == "Choose the file of the measured lens first."
    widget.settings.lens.file.value = "none.npz"
    assert widget.run() is None
    assert "no such file" in messages()[2]


def test_second_threshold_does_not_estimate_again(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    finish(widget)
    assert viewer.layers["leaf in focus"].data.max() == 0
    widget.settings.threshold.value = 3
    finish(widget)
    assert viewer.layers["leaf in focus"].data.min() == 1
    assert len(method.estimations) == 1
    assert len(viewer.layers) == 5


def test_painted_seeds_reach_the_mask_without_another_estimation(
    window, docked, finish, method, texture
):
    window.add_image(texture, name="leaf", scale=(2, 3))
    widget = docked(DefocusWidget)
    finish(widget)
    assert method.segmentations[0]["seeds"] is None
    widget.seeds_button.native.click()
    assert widget.seeds.value.name == "leaf seeds"
    window.layers["leaf seeds"].data[5:9, 7] = 2
    window.layers.remove("leaf in focus")
    finish(widget)
    assert window.layers.selection.active.name == "leaf seeds", "the brush stays where it is"
    expected = np.zeros(texture.shape)
    expected[5:9, 7] = 2
    np.testing.assert_array_equal(method.segmentations[1]["seeds"], expected)
    assert window.layers["leaf in focus"].metadata["napari_defocus"]["seeds"] == "leaf seeds"
    assert len(method.estimations) == 1
    window.layers.remove("leaf seeds")
    assert widget.seeds.value is None
    finish(widget)
    assert method.segmentations[2]["seeds"] is None


def test_seeds_are_any_labels_but_results(window, docked, finish, method, texture):
    window.add_image(texture, name="leaf")
    widget = docked(DefocusWidget)
    finish(widget)
    window.add_labels(np.zeros(texture.shape, int), name="mine")
    widget.seeds_button.native.click()
    widget.seeds_button.native.click()
    names = [layer and layer.name for layer in widget.seeds.choices]
    assert names == [None, "mine", "leaf seeds", "leaf seeds [1]"]
    assert widget.seeds.value.name == "leaf seeds [1]", "a new layer; nothing painted is lost"


def test_seeds_that_do_not_fit_are_said_in_plain_words(viewer, opened, method, texture, messages):
    viewer.add_image(texture, name="leaf")
    viewer.add_labels(np.full(texture.shape, 7), name="cells")
    widget = opened(DefocusWidget)
    widget.seeds.value = viewer.layers["cells"]
    assert widget.run() is None
    assert messages() == [
        "“cells” cannot be the seeds of “leaf”: seeds has the value 7; it takes 0 (not known), "
        "1 (in focus) and 2 (blurred). “New seeds layer” makes one that fits."
    ]


def test_seeds_without_an_image_are_said_in_plain_words(viewer, opened, messages):
    assert opened(DefocusWidget).add_seeds() is None
    assert messages() == ["There is no image to paint seeds on. Open an image first."]


def test_a_second_dock_reuses_the_estimation_of_the_first(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    finish(opened(DefocusWidget))
    finish(opened(DefocusWidget))
    assert len(method.estimations) == 1


def test_cancel_ends_the_work_at_its_next_report_and_leaves_no_layer(
    viewer, opened, qtbot, endless_method, texture, messages
):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    run = widget.run()
    qtbot.waitUntil(lambda: widget.status.value == "Estimating blur")
    assert not widget.run_button.enabled
    with qtbot.waitSignal(run.finished):
        widget.cancel_button.native.click()
    assert names(viewer) == ["leaf"]
    assert widget.run_button.enabled
    assert not widget.cancel_button.enabled
    assert messages() == []
    assert widget.status.value == "Cancelled"


def test_refusal_stays_in_the_form_when_the_message_has_gone(viewer, opened, finish, messages):
    viewer.add_image(np.ones((1, 1)), name="dot")
    widget = opened(DefocusWidget)
    finish(widget)
    assert [widget.status.value] == messages()
    assert "“dot”" in widget.status.value


def test_cancel_in_naparis_activity_list_acts_too(window, docked, qtbot, endless_method, texture):
    window.add_image(texture, name="leaf")
    widget = docked(DefocusWidget)
    run = widget.run()
    qtbot.waitUntil(lambda: bool(endless_method.estimations))
    with qtbot.waitSignal(run.finished):
        run.bar.cancel()
    assert names(window) == ["leaf"]


def test_run_while_one_runs_is_the_one_that_runs(viewer, opened, qtbot, endless_method, texture):
    viewer.add_image(texture)
    widget = opened(DefocusWidget)
    run = widget.run()
    assert widget.run() is run
    with qtbot.waitSignal(run.finished):
        widget.cancel()
    assert len(endless_method.estimations) <= 1


def test_removed_layer_ends_its_run_without_a_word(
    viewer, opened, qtbot, endless_method, texture, messages
):
    viewer.add_image(texture, name="leaf")
    viewer.add_image(texture, name="other")
    widget = opened(DefocusWidget)
    widget.image.value = viewer.layers["leaf"]
    run = widget.run()
    qtbot.waitUntil(lambda: bool(endless_method.estimations))
    with qtbot.waitSignal(run.finished):
        viewer.layers.remove("leaf")
    assert names(viewer) == ["other"]
    assert messages() == []


def test_deleted_layer_takes_its_candidates_with_it(window, docked, finish, method, texture, qtbot):
    window.add_image(texture, name="leaf")
    finish(docked(DefocusWidget))
    assert len(ImagePanel.cache.analysed) == 1
    window.layers.clear()
    qtbot.waitUntil(lambda: collected() and len(ImagePanel.cache.analysed) == 0)


def collected():
    import gc

    gc.collect()
    return True


def test_picture_replaced_while_it_runs_gets_no_result(
    viewer, opened, qtbot, method, texture, messages, monkeypatch
):
    layer = viewer.add_image(texture, name="leaf")
    go_on = []

    def estimate_candidates(image, *, progress, **arguments):
        while not go_on:
            progress("Estimating blur", 0.2)
            time.sleep(0.01)
        return method.estimate_candidates(image, progress=progress, **arguments)

    monkeypatch.setitem(vars(napari_defocus), "estimate_candidates", estimate_candidates)
    widget = opened(DefocusWidget)
    run = widget.run()
    layer.data = texture[:50].copy()
    with qtbot.waitSignal(run.finished):
        go_on.append(True)
    assert names(viewer) == ["leaf"]
    assert "changed while" in messages()[0]


def test_no_image_is_said_in_plain_words(viewer, opened, messages):
    viewer.add_labels(np.zeros((20, 20), int))
    assert opened(DefocusWidget).run() is None
    assert messages() == ["There is no image to analyse. Open an image first."]


def test_infinity_is_said_in_plain_words(viewer, opened, finish, method, texture, messages):
    texture[3, 4] = np.inf
    viewer.add_image(texture, name="leaf")
    finish(opened(DefocusWidget))
    [message] = messages()
    assert message.startswith("Cannot analyse “leaf”: it has infinite pixels")
    assert names(viewer) == ["leaf"]


def test_too_small_a_picture_is_said_in_plain_words(viewer, opened, finish, messages):
    viewer.add_image(np.zeros((2, 40), np.uint8), name="line")
    finish(opened(DefocusWidget))
    [message] = messages()
    assert message.startswith("Cannot analyse “line”:")
    assert "at least 3 px" in message


def test_volume_rendering_is_said_in_plain_words(viewer, opened, messages):
    viewer.add_image(np.zeros((5, 40, 40), np.uint8), name="stack")
    viewer.dims.ndisplay = 3
    assert opened(DefocusWidget).run() is None
    assert "Switch the viewer to 2-D" in messages()[0]


def test_noise_variance_that_is_no_number_is_said_in_plain_words(viewer, opened, texture, messages):
    viewer.add_image(texture)
    widget = opened(DefocusWidget)
    widget.settings.noise_variance.value = "low"
    assert widget.run() is None
    assert "Type a number such as 1e-5" in messages()[0]


def test_defect_of_the_method_is_reported_once_and_the_widget_goes_on(
    viewer, opened, finish, method, texture, messages, monkeypatch
):
    def broken(image, **arguments):
        raise RuntimeError("a defect")

    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    with monkeypatch.context() as patched:
        patched.setitem(vars(napari_defocus), "estimate_candidates", broken)
        finish(widget)
    assert messages() == ["a defect"]
    finish(widget)
    assert names(viewer) == ["leaf", *MADE]


def test_active_image_is_chosen_and_results_are_not_offered(
    viewer, opened, finish, method, texture
):
    viewer.add_image(texture, name="first")
    viewer.add_image(texture, name="second")
    viewer.layers.selection.active = viewer.layers["second"]
    widget = opened(DefocusWidget)
    assert widget.image.value.name == "second"
    finish(widget)
    assert [layer.name for layer in widget.image.choices] == ["first", "second"]
    assert widget.image.value.name == "second"


def test_closing_the_widget_ends_its_run(window, docked, qtbot, endless_method, texture, messages):
    window.add_image(texture, name="leaf")
    widget = docked(DefocusWidget)
    run = widget.run()
    qtbot.waitUntil(lambda: bool(endless_method.estimations))
    with qtbot.waitSignal(run.finished):
        window.window.remove_dock_widget("all")
        widget.native.deleteLater()
    window.layers.remove("leaf")
    assert messages() == []


def test_widgets_are_in_the_menus(window):
    for menu in (window.window.layers_menu, window.window.plugins_menu):
        shown = list(texts(menu))
        for name in ("Measure defocus", "Why here?", "Change focus", "Calibrate a lens"):
            assert f"{name} (Defocus)" in shown


def texts(menu):
    for action in menu.actions():
        yield action.text()
        if action.menu():
            yield from texts(action.menu())
