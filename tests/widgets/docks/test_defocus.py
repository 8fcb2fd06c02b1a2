"""The one dock that leads through everything."""

import json
import runpy
from itertools import pairwise

import numpy as np
import pytest
from imageio.v3 import imwrite
from magicgui.widgets import PushButton
from napari.settings import get_plugin_settings
from npe2 import PluginManifest
from qtpy.QtCore import QPoint, Qt
from qtpy.QtWidgets import QApplication

import napari_defocus
from napari_defocus import Settings, ThinLens, simulate_defocus
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.docks.defocus import DEPTH, MASK, MORE, STACK, DefocusWidget
from napari_defocus.widgets.layers.preferences import PLUGIN

pytestmark = pytest.mark.display


@pytest.fixture
def leaf(viewer, texture):
    return viewer.add_image(texture, name="leaf", scale=(2, 3))


@pytest.fixture
def finished(qtbot):
    def wait(run):
        assert run is not None
        with qtbot.waitSignal(run.finished):
            pass

    return wait


@pytest.fixture
def measured(leaf, opened, finish, method):
    widget = opened(DefocusWidget)
    finish(widget)
    return widget


def names(viewer):
    return [layer.name for layer in viewer.layers]


def test_one_press_gives_map_confidence_mask_and_veil(viewer, measured):
    made = ["leaf blur (px)", "leaf confidence", "leaf in focus", "leaf not trusted"]
    assert names(viewer) == ["leaf", *made]
    said = measured.status.value
    assert said.index("Blur: median") < said.index("In focus:") < said.index("Noise variance")


def test_it_tells_a_first_time_user_what_to_do(opened):
    assert "press “Measure”" in opened(DefocusWidget).status.value


def test_what_is_done_no_more_is_not_said(measured, finished):
    finished(measured.tools.add_regions())
    assert measured.status.value == "Nothing is in focus."


def test_nothing_is_said_of_results_and_pictures_that_are_gone(viewer, measured):
    for layer in list(viewer.layers)[1:]:
        viewer.layers.remove(layer)
    assert "were removed" in measured.status.value
    measured.settings.threshold.value = 3.0
    assert names(viewer) == ["leaf"], "a slider does not bring them back"
    viewer.layers.clear()
    assert measured.status.value.startswith("Open a picture")


def test_what_was_said_of_a_layer_goes_with_it(viewer, measured, finished):
    finished(measured.tools.add_regions())
    viewer.layers.remove("leaf regions")
    assert "Noise variance" in measured.status.value


def test_each_picture_has_its_own_words(viewer, measured, texture):
    viewer.add_image(texture[::-1], name="other")
    measured.reset_choices()
    measured.image.value = viewer.layers["other"]
    assert "how blurred is “other”" in measured.status.value
    measured.image.value = viewer.layers["leaf"]
    assert "Noise variance" in measured.status.value


def test_a_single_picture_after_a_stack_has_no_planes(viewer, opened, finish, method, texture):
    viewer.add_image(np.stack([texture] * 3), name="stack")
    widget = opened(DefocusWidget)
    widget.planes.value = "all"
    assert "all 3 planes" in widget.status.value
    viewer.add_image(texture, name="leaf")
    widget.reset_choices()
    widget.image.value = viewer.layers["leaf"]
    finish(widget)
    assert "plane" not in widget.status.value
    assert viewer.layers["leaf blur (px)"].data.shape == texture.shape


def test_every_button_explains_itself(opened):
    tools = opened(DefocusWidget).tools
    for button in vars(tools).values():
        if isinstance(button, PushButton):
            assert len(button.tooltip) > 30


def test_planes_are_asked_for_in_stacks_only(viewer, opened, texture):
    viewer.add_image(texture, name="leaf")
    viewer.add_image(np.stack([texture] * 3), name="stack")
    widget = opened(DefocusWidget)
    for name, shown in [("leaf", False), ("stack", True), ("leaf", False)]:
        widget.image.value = viewer.layers[name]
        assert widget.planes.native.isHidden() != shown
        assert widget.tools.curve.enabled == shown


def test_mask_follows_the_threshold(viewer, measured, qtbot, method):
    measured.settings.threshold.value = 3.0
    qtbot.waitUntil(lambda: viewer.layers["leaf in focus"].data.min() == 1)
    assert len(method.estimations) == 1


def test_restoration_and_depth_use_the_map_that_is_there(viewer, measured, finished, method):
    finished(measured.restore())
    lens = measured.depth.thin_lens
    lens.focal_length.value, lens.f_number.value = "50", "2"
    lens.focus_distance.value, lens.pixel_pitch.value = "2", "50"
    finished(measured.estimate_depth())
    assert names(viewer)[-2:] == ["leaf all in focus", "leaf depth (m)"]
    assert len(method.estimations) == len(method.labelings) == len(method.restorations) == 1
    expected = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=50)
    depth = viewer.layers["leaf depth (m)"].data
    known = depth[np.isfinite(depth)]
    np.testing.assert_allclose(
        known, napari_defocus.depth_from_blur(np.full(1, method.radius), expected)[0], rtol=1e-5
    )


def test_restoration_takes_another_map_where_there_is_one(viewer, leaf, measured, finished, method):
    assert measured.other_map.native.isHidden(), "there is no choice"
    viewer.add_image(np.full(leaf.data.shape, 1.5, np.float32), name="by hand")
    measured.reset_choices()
    assert not measured.other_map.native.isHidden()
    measured.other_map.value = viewer.layers["by hand"]
    finished(measured.restore())
    assert method.restorations[0]["blur_map"].max() == 1.5
    viewer.layers.remove("by hand")
    measured.reset_choices()
    assert measured.other_map.value is None


def test_missing_numbers_of_the_lens_are_asked_for(measured, messages):
    measured.pages.show(DEPTH)
    assert measured.estimate_depth() is None
    assert "Fill in the focal length" in messages()[-1]


def test_new_seeds_are_ready_to_paint(viewer, measured):
    measured.add_seeds()
    assert measured.pages.sections[MASK].is_open
    seeds = viewer.layers.selection.active
    assert (seeds.name, seeds.mode) == ("leaf seeds", "paint")
    assert measured.seeds.value == seeds


def test_picture_is_seen_through_its_map_while_seeds_are_painted(viewer, measured, finish):
    blur_map, veil = viewer.layers["leaf blur (px)"], viewer.layers["leaf not trusted"]
    blur_map.opacity = 0.9
    before = veil.opacity
    seeds = measured.add_seeds()
    assert (blur_map.opacity, veil.opacity) == (0.45, before / 2)
    seeds.mode = "pan_zoom"
    assert (blur_map.opacity, veil.opacity) == (0.9, before)
    seeds.mode = "paint"
    finish(measured)
    assert blur_map.opacity == 0.45, "results that are renewed are seen through, too"
    viewer.layers.selection.active = blur_map
    assert (blur_map.opacity, veil.opacity) == (0.9, before)


def test_opacity_that_is_chosen_while_painting_stays(viewer, measured):
    blur_map = viewer.layers["leaf blur (px)"]
    seeds = measured.add_seeds()
    blur_map.opacity = 0.2
    seeds.mode = "pan_zoom"
    assert blur_map.opacity == 0.2


def test_seeds_lie_above_a_map_that_comes_after_them(viewer, leaf, opened, finish, method):
    widget = opened(DefocusWidget)
    seeds = widget.add_seeds()
    finish(widget)
    assert viewer.layers[-1] is seeds
    assert viewer.layers.selection.active is seeds


def test_earlier_results_stay_if_that_is_wanted(viewer, measured, finish, method):
    before = viewer.layers["leaf blur (px)"].data.copy()
    measured.keep_earlier.value = True
    measured.settings.max_radius.value = 16.0
    method.radius = 11.3
    finish(measured)
    assert [call["psf"].max_radius for call in method.estimations] == [64.0, 16.0]
    expected = {"leaf blur (px)", "leaf blur (px) 2", "leaf confidence 2", "leaf in focus 2"}
    assert expected <= set(names(viewer))
    np.testing.assert_array_equal(viewer.layers["leaf blur (px)"].data, before)
    assert tuple(viewer.layers["leaf blur (px)"].contrast_limits) == (0.0, 8.0)
    assert tuple(viewer.layers["leaf blur (px) 2"].contrast_limits) == (0.0, 12.0)


def test_results_go_with_a_picture_that_is_renamed(viewer, measured, finish, qtbot, method):
    viewer.layers["leaf"].name = "oak"
    made = ["oak blur (px)", "oak confidence", "oak in focus", "oak not trusted"]
    assert names(viewer) == ["oak", *made]
    measured.settings.threshold.value = 3.0
    qtbot.waitUntil(lambda: viewer.layers["oak in focus"].data.min() == 1)
    finish(measured)
    assert names(viewer) == ["oak", *made]
    assert len(method.estimations) == 1


def test_what_does_not_follow_says_which_button_to_press(viewer, measured, method):
    measured.region.value = "whole"
    measured.settings.max_radius.value = 6.0
    measured.settings.threshold.value = 3.0
    assert "Press “Measure”" in measured.status.value


def test_nothing_to_be_known_is_said(viewer, measured, finish, method, monkeypatch):
    def unsure(candidates, blur_map):
        return np.zeros(blur_map.shape, np.float32)

    monkeypatch.setitem(vars(napari_defocus), "confidence_map", unsure)
    measured.settings.max_radius.value = 6.0
    finish(measured)
    assert "Nothing can be known here" in measured.status.value


def test_a_picture_that_tells_little_is_said_to_be_one(viewer, opened, finish, method):
    viewer.add_image(np.full((90, 100), 7, np.uint8), name="wall")
    widget = opened(DefocusWidget)
    finish(widget)
    assert widget.status.value.startswith("All pixels have the same value")


def test_a_run_on_all_planes_gives_stacks_and_then_one_plane_is_renewed(
    viewer, opened, finish, method, texture, qtbot
):
    viewer.add_image(np.stack([texture, texture[::-1], texture]), name="stack", scale=(5, 1, 1))
    widget = opened(DefocusWidget)
    widget.planes.value = "all"
    finish(widget)
    maps = viewer.layers["stack blur (px)"]
    assert maps.data.shape == (3, *texture.shape)
    assert len(method.estimations) == 3
    widget.settings.threshold.value = 3.0
    assert "Press “Measure”" in widget.status.value, "not all planes at every move"
    widget.planes.value = "shown"
    widget.settings.threshold.value = 3.5
    masks = viewer.layers["stack in focus"]
    qtbot.waitUntil(lambda: [plane.max() for plane in masks.data] == [0, 1, 0])
    viewer.dims.set_current_step(0, 2)
    method.radius = 5.0
    finish(widget)
    assert [float(np.median(plane)) for plane in maps.data] == [2.5, 2.5, 5.0]
    assert viewer.layers["stack blur (px)"] is maps
    assert tuple(maps.scale) == (5, 1, 1)


def test_part_of_the_picture_is_measured_where_it_lies_and_beside_the_whole(
    viewer, leaf, opened, finish, finished, method
):
    shapes = viewer.add_shapes([np.array([[20, 30], [20, 120], [100, 120], [100, 30]])])
    widget = opened(DefocusWidget)
    finish(widget)
    whole = viewer.layers["leaf blur (px)"].data.copy()
    widget.region.value = shapes
    method.radius = 1.0
    finish(widget)
    assert method.estimations[1]["image"].shape == (41, 31)
    part = viewer.layers["leaf (Shapes) blur (px)"]
    assert tuple(part.translate) == (20, 30)
    assert part.data.max() == 1.0
    np.testing.assert_array_equal(viewer.layers["leaf blur (px)"].data, whole)
    covers = "leaf not trusted", "leaf (Shapes) not trusted"
    assert [viewer.layers[name].data.shape for name in covers] == [whole.shape, (41, 31)]
    assert viewer.layers.selection.active is part
    assert "Measured: shapes “Shapes”" in widget.status.value
    bars = [layer.colorbar.position for layer in (part, viewer.layers["leaf blur (px)"])]
    assert bars[0] != bars[1], "names side by side would be wider than a small window"
    assert not shapes.face_color[:, 3].any(), "the fill covers no result"
    finished(widget.tools.add_regions())
    assert viewer.layers["leaf (Shapes) regions"].data.shape == (41, 31)


def test_settings_are_saved_and_loaded(viewer, measured, opened, tmp_path, messages):
    measured.settings.lens.take("polygon:5")
    measured.settings.max_radius.value = 5.0
    measured.settings.threshold.value = 1.5
    measured.settings.map_smoothness.value = 33.0
    file = tmp_path / "mine.json"
    measured.tools.save(file)
    assert json.loads(file.read_text())["map"]["psf"].startswith("polygon:5")
    other = opened(DefocusWidget)
    other.tools.load(file)
    assert other.settings.map_settings() == measured.settings.map_settings()
    assert other.settings.mask_settings() == measured.settings.mask_settings()
    assert Settings.load(file).map.max_radius == 5.0
    measured.tools.save(file)
    assert "exists" in messages()[-1]


def test_settings_that_have_no_field_are_kept(opened, tmp_path):
    file = tmp_path / "mine.json"
    Settings(map=MapSettings(window=31, stride=5)).save(file)
    widget = opened(DefocusWidget)
    widget.tools.load(file)
    assert widget.settings.map_settings() == MapSettings(window=31, stride=5)


def test_file_that_holds_no_settings_is_refused_in_words(opened, tmp_path, messages):
    file = tmp_path / "mine.json"
    file.write_text('{"map": {"max_radius": "large"}}')
    widget = opened(DefocusWidget)
    widget.tools.load(file)
    assert "max_radius" in messages()[-1]
    assert widget.settings.map_settings() == MapSettings()


def test_form_begins_with_what_preferences_say(viewer, opened, plugin_settings, npe2pm):
    from pathlib import Path

    file = Path(napari_defocus.__file__).with_name("napari.yaml")
    npe2pm.register(PluginManifest.from_file(file))
    preferences = get_plugin_settings(PLUGIN)
    preferences.map.max_radius = 5.0
    preferences.mask.threshold = 1.5
    preferences.display.live = False
    preferences.display.min_confidence = 0.25
    widget = opened(DefocusWidget)
    assert widget.settings.map_settings() == MapSettings(max_radius=5.0)
    assert widget.settings.mask_settings() == MaskSettings(threshold=1.5)
    assert not widget.live.value
    assert widget.settings.min_confidence.value == 0.25


def test_map_is_saved_and_opened_again(viewer, measured, tmp_path):
    file = tmp_path / "leaf-blur.tif"
    measured.tools.save_blur_map(file)
    before = viewer.layers["leaf blur (px)"]
    measured.tools.open_saved(file)
    again = viewer.layers[-1]
    np.testing.assert_array_equal(again.data, before.data)
    assert tuple(again.scale) == (2, 3)
    assert again.metadata["napari_defocus"]["result"] == "blur map"


def test_dialogs_name_without_an_ending_replaces_no_other_file(
    measured, monkeypatch, tmp_path, messages
):
    chosen = tmp_path / "leaf"
    monkeypatch.setattr(measured.tools, "_asked_to_save", lambda *_: chosen)
    measured.tools.save_blur_map()
    assert measured.status.value == "Saved leaf-blur.tif"
    before = (tmp_path / "leaf-blur.tif").stat().st_mtime_ns
    measured.tools.save_blur_map()
    assert "exists" in messages()[0]
    assert (tmp_path / "leaf-blur.tif").stat().st_mtime_ns == before


@pytest.mark.parametrize("press", ["save_blur_map", "add_regions", "toggle_3d", "copy_script"])
@pytest.mark.parametrize("image", [False, True])
def test_what_cannot_be_done_yet_is_said_in_words(
    viewer, opened, texture, messages, press, image, finished
):
    if image:
        viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    run = getattr(widget.tools, press)()
    if press == "copy_script" and image:
        finished(run)
        assert "clipboard" in messages()[-1]
        return
    assert run is None
    assert messages()
    assert "Traceback" not in messages()[-1]


def test_regions_are_numbered_in_a_table(viewer, measured, finished, method):
    method.radius = 1.0
    measured.settings.max_radius.value = 6.0
    finished(measured.run())
    finished(measured.tools.add_regions())
    regions = viewer.layers["leaf regions"]
    assert regions.data.max() == 1
    assert regions.features["share_percent"].iloc[1] == pytest.approx(100)
    assert "1 region is in focus" in measured.status.value


def test_relief_and_the_way_back(viewer, measured, finished):
    visible = [layer.visible for layer in viewer.layers]
    finished(measured.tools.toggle_3d())
    assert viewer.dims.ndisplay == 3
    assert measured.tools.relief.text == "Back to 2-D"
    assert "Turn the relief" in measured.status.value
    assert measured.tools.toggle_3d() is None
    assert viewer.dims.ndisplay == 2
    assert [layer.visible for layer in viewer.layers] == visible
    assert measured.tools.relief.text == "Show in 3-D"
    assert "Turn the relief" not in measured.status.value


def test_copied_script_gives_the_same_map_and_mask_bit_for_bit(
    window, docked, finish, finished, gravel, tmp_path
):
    radius = np.full(gravel.shape, 3.5)
    radius[:, :70] = 0.8
    picture = simulate_defocus(gravel, radius, noise_variance=1e-5, rng=0)
    file = tmp_path / "stones.png"
    imwrite(file, (255 * picture).round().astype(np.uint8))
    window.open(file, plugin="napari")
    widget = docked(DefocusWidget)
    widget.settings.threshold.value = 1.6
    widget.settings.map_smoothness.value = 12.0
    finish(widget)
    finished(widget.tools.copy_script())
    script = tmp_path / "again.py"
    script.write_text(QApplication.clipboard().text())
    found = runpy.run_path(str(script))
    for variable, layer in {
        "blur_map": "stones blur (px)",
        "confidence": "stones confidence",
        "in_focus": "stones in focus",
    }.items():
        np.testing.assert_array_equal(found[variable], window.layers[layer].data)
    assert 0.2 < found["in_focus"].mean() < 0.8


def test_sections_open_and_close_and_that_of_stacks_is_there_for_stacks(viewer, opened, texture):
    widget = opened(DefocusWidget)
    sections = widget.pages.sections
    assert list(sections) == [
        *("Map", "In focus", "Restore", "Depth", "Stack", "Save and open", "More")
    ]
    assert [title for title in sections if sections[title].is_open] == [MASK]
    sections[MORE].heading.click()
    assert not sections[MORE].form.isHidden()
    sections[MORE].heading.click()
    assert sections[MORE].form.isHidden()
    assert sections[STACK].isHidden()
    viewer.add_image(np.stack([texture] * 3), name="stack")
    widget.reset_choices()
    assert not sections[STACK].isHidden()


def test_everything_is_reached_by_the_tab_key_from_top_to_bottom_and_has_a_name(opened):
    widget = opened(DefocusWidget)
    native = widget.native
    for section in widget.pages.sections.values():
        section.open()
    native.show()
    reached, stop = [], widget.image.native
    while stop not in reached:
        if stop.focusPolicy() & Qt.TabFocus and stop.isVisibleTo(native):
            reached.append(stop)
            assert stop.accessibleName(), stop
        stop = stop.nextInFocusChain()
    content = widget.pages.native.widget()
    tops = [s.mapTo(content, QPoint(0, 0)).y() for s in reached if content.isAncestorOf(s)]
    assert len(tops) > 40
    assert all(below > above - 10 for above, below in pairwise(tops)), "fields of a row are level"
    bottom = [widget.tools.probe.native, widget.tools.relief.native]
    assert reached[-2:] == bottom
    buttons = [widget.run_button, widget.seeds_button, widget.restore_button, widget.depth_button]
    assert {button.native for button in buttons} <= set(reached)
    assert [stop.accessibleName() for stop in reached].count("in focus up to (px)") == 3


def test_probe_and_focus_curve_open_beside_it(window, docked, finish, method, texture, qtbot):
    window.add_image(np.stack([texture] * 2), name="stack")
    widget = docked(DefocusWidget)
    finish(widget)
    widget.tools.open_probe()
    widget.tools.open_focus_curve()
    probe = widget.tools._probe()
    explained = []
    probe.refresh = lambda: explained.append(True)
    widget.settings.threshold.value = 3.0
    qtbot.waitUntil(lambda: bool(explained))
    docks = list(window.window.dock_widgets)
    assert {"Why here? (Defocus)", "Focus curve (Defocus)"} <= set(docks), "as from the menus"
    widget.tools.open_probe()
    assert list(window.window.dock_widgets) == docks, "no second one"
