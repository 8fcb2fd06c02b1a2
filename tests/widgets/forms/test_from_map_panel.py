"""The widgets that make something of a picture and its blur map."""

import time

import numpy as np
import PIL.Image
import pytest
from napari.utils.interactions import mouse_press_callbacks, mouse_release_callbacks

import napari_defocus
from napari_defocus import RestorationFit
from napari_defocus.widgets.docks.change_focus import PICK, PICKING, ChangeFocusWidget
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.layers.picker import value_at

pytestmark = pytest.mark.display

RESTORE, REFOCUS, DEPTH = (
    (DefocusWidget, "restore"),
    (ChangeFocusWidget, "run"),
    (DefocusWidget, "estimate_depth"),
)
"""Docks, and what is called in them."""

WAYS = pytest.mark.parametrize(("dock", "action"), [RESTORE, REFOCUS, DEPTH])


def names(viewer):
    return [layer.name for layer in viewer.layers]


def ready(widget):
    """Fill in what has no default."""
    if isinstance(widget, DefocusWidget):
        lens = widget.depth.thin_lens
        lens.focal_length.value, lens.f_number.value = "50", "2"
        lens.focus_distance.value, lens.pixel_pitch.value = "2", "50"
    return widget


@pytest.fixture
def done(qtbot):
    """Call a method of a widget that starts a run, and wait for its end."""

    def wait(widget, action):
        with qtbot.waitSignal(getattr(widget, action)().finished):
            pass

    return wait


def choose_map(widget, layer):
    widget.reset_choices()
    field = widget.other_map if isinstance(widget, DefocusWidget) else widget.blur_map
    field.value = layer


def shown(fields):
    return [field for field in fields if not field.native.isHidden()]


def test_widgets_make_their_layers_and_those_of_the_map(window, docked, done, method, texture):
    window.add_image(texture, name="leaf", scale=(2, 3), units=("um", "um"), axis_labels=("y", "x"))
    shown, of_the_map = ["leaf"], ["leaf blur (px)", "leaf confidence"]
    for (dock, action), made in (
        (RESTORE, "leaf all in focus"),
        (REFOCUS, "leaf refocused"),
        (DEPTH, "leaf depth (m)"),
    ):
        widget = ready(docked(dock))
        shown.append(made)
        for _ in range(2):
            done(widget, action)
            assert names(window) == [*shown[:-1], *of_the_map, made]
        assert len(method.estimations) == len(method.labelings) == 1
        for layer in list(window.layers)[1:]:
            assert tuple(layer.scale) == (2, 3)
            assert [str(unit) for unit in layer.units] == ["micrometer", "micrometer"]
            assert layer.axis_labels == ("y", "x")
        assert [layer.name for layer in window.layers if layer.visible] == shown
        if dock is ChangeFocusWidget:
            choices = [choice and choice.name for choice in widget.blur_map.choices]
            assert choices == [None, "leaf blur (px)"]
        assert [layer.name for layer in widget.image.choices] == ["leaf"]
        # Each makes the map's layers anew if they are not there.
        for name in of_the_map:
            window.layers.remove(name)


def test_map_that_was_made_on_the_way_is_shown_once_it_is_asked_for(
    viewer, opened, finish, done, method, texture
):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    done(widget, "restore")
    assert not viewer.layers["leaf blur (px)"].visible
    finish(widget)
    assert viewer.layers["leaf blur (px)"].visible
    assert not viewer.layers["leaf confidence"].visible
    assert len(method.estimations) == 1


def test_every_field_explains_itself(opened):
    widget, defocus = opened(ChangeFocusWidget), opened(DefocusWidget)
    fields = [
        field
        for field in (*widget, *defocus.restoration.fields(), *defocus.depth.fields())
        if field.native.isEnabled()
        and field.name not in ("", "side_note", "progress", "status", "more")
    ]
    assert len(fields) > 20
    for field in fields:
        assert len(field.tooltip) > 40, field.name


def test_only_what_the_chosen_map_leaves_open_is_asked_for(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    finish(opened(DefocusWidget))
    theirs = viewer.add_image(np.ones(texture.shape), name="theirs")
    widget = opened(ChangeFocusWidget)
    widget.image.value = viewer.layers["leaf"]
    settings = widget.settings
    settings.more.native.click()
    more = len(settings.more_fields())
    for layer, lens, largest, count in (
        (None, True, True, more),
        (theirs, True, False, 1),
        (viewer.layers["leaf blur (px)"], False, False, 1),
        (None, True, True, more),
    ):
        widget.blur_map.value = layer
        assert bool(shown([settings.lens.lens])) == lens
        assert bool(shown([settings.max_radius])) == largest
        assert len(shown(settings.more_fields())) == count
        assert bool(shown([settings.more])) == (count > 0)


def test_fields_reach_the_method(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(ChangeFocusWidget)
    widget.settings.lens.take("polygon:5")
    widget.settings.noise_variance.value = "1e-4"
    widget.restoration.tv_weight.value = "2e-3"
    widget.restoration.protect.value = False
    widget.focus.value, widget.aperture.value = 1.5, 2.5
    widget.side.value = "near"
    finish(widget)
    [restored], [seen] = method.restorations, method.refocusings
    assert restored["psf"] == seen["psf"] == napari_defocus.Polygon(5)
    assert restored["noise_variance"] == method.estimations[0]["noise_variance"] == 1e-4
    assert restored["tv_weight"] == 2e-3
    assert restored["confidence"] is None
    assert restored["linearize"] == seen["linearize"] == "srgb"
    assert method.estimations[0]["linearize"] is None
    assert (seen["focus"], seen["aperture"], seen["side"]) == (1.5, 2.5, "near")


def test_noise_that_grows_leaves_the_noise_to_be_found(viewer, opened, done, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    widget.settings.noise_variance.value = "nonsense that has no say"
    widget.settings.shot_noise.value = True
    done(widget, "restore")
    assert len(method.noises) == len(method.restorations) == 1


@WAYS
def test_map_of_a_layer_is_used(viewer, opened, done, method, texture, dock, action):
    viewer.add_image(texture, name="leaf")
    theirs = viewer.add_image(np.full(texture.shape, 3.0), name="theirs")
    widget = ready(opened(dock))
    widget.image.value = viewer.layers["leaf"]
    choose_map(widget, theirs)
    done(widget, action)
    assert not method.estimations
    assert len(viewer.layers) == 3


def test_chosen_map_that_is_removed_is_estimated_again(window, docked, texture):
    window.add_image(texture, name="leaf")
    theirs = window.add_image(np.ones(texture.shape), name="theirs")
    widget = docked(ChangeFocusWidget)
    widget.image.value = window.layers["leaf"]
    widget.blur_map.value = theirs
    window.layers.remove("theirs")
    assert widget.blur_map.value is None
    assert shown([widget.settings.max_radius])


def test_sliders_only_blur_again_once_there_is_a_result(
    viewer, opened, finish, qtbot, method, texture
):
    viewer.add_image(texture, name="leaf")
    widget = opened(ChangeFocusWidget)
    widget.focus.value = 1.0
    assert widget._running is None, "nothing is restored without being asked for"
    finish(widget)
    widget.focus.value = 4.0
    qtbot.waitUntil(lambda: widget._running is None)
    assert viewer.layers["leaf refocused"].data.max() == np.float32(0.4)
    widget.side.value = "near"
    widget.aperture.value = 2.0
    qtbot.waitUntil(lambda: widget._running is None)
    assert method.refocusings[-1]["side"] == "near"
    assert method.refocusings[-1]["aperture"] == 2.0, "what was set while it ran counts, too"
    assert len(method.restorations) == 1
    widget.restoration.tv_weight.value = "1e-3"
    widget.focus.value = 2.0
    assert widget._running is None, "it would have to be restored again"
    widget.restoration.tv_weight.value = ""
    widget.follow.value = False
    widget.focus.value = 3.0
    assert widget._running is None
    assert len(method.restorations) == 1


def test_slider_and_number_are_one(opened):
    focus = opened(ChangeFocusWidget).focus
    focus.value = 3.25
    assert focus.slider.value == pytest.approx(3.25)
    focus.slider.value = 1.5
    assert focus.value == 1.5
    focus.largest = 1.0
    assert focus.largest == focus.value == 1.5


def test_focus_reaches_as_far_as_the_blur(viewer, opened, texture):
    viewer.add_image(texture, name="leaf")
    theirs = viewer.add_image(np.full(texture.shape, 12.0), contrast_limits=(0, 12))
    widget = opened(ChangeFocusWidget)
    widget.image.value = viewer.layers["leaf"]
    assert widget.focus.largest == 8
    widget.settings.max_radius.value = 10
    assert widget.focus.largest == 8, "what is looked for need not be there"
    choose_map(widget, theirs)
    assert widget.focus.largest == 12
    choose_map(widget, None)
    assert widget.focus.largest == 8


class Press:
    type = "mouse_press"
    handled = False
    button = 1
    modifiers = ()

    def __init__(self, position):
        self.position = position


def click(viewer, position):
    mouse_press_callbacks(viewer, Press(position))
    mouse_release_callbacks(viewer, Press(position))


def test_focus_is_picked_with_one_click_and_with_no_other(viewer, opened, qtbot, texture):
    viewer.add_image(texture, name="leaf", scale=(2, 2))
    radii = np.tile(np.linspace(0, 6, texture.shape[1]), (len(texture), 1))
    theirs = viewer.add_image(radii, scale=(2, 2), contrast_limits=(0, 6))
    seeds = viewer.add_labels(np.zeros(texture.shape, int))
    seeds.mode = "paint"
    widget = opened(ChangeFocusWidget)
    widget.image.value = viewer.layers["leaf"]
    choose_map(widget, theirs)
    before = list(viewer.mouse_drag_callbacks)
    click(viewer, (100, 100))
    assert widget.focus.value == 0, "no click was waited for"
    widget.pick.native.click()
    assert widget.pick.text == PICKING
    assert seeds.mode == "pan_zoom", "a click paints nothing"
    click(viewer, (-50, 100))
    assert "No blur is known there" in widget.status.value
    click(viewer, (100, 100))
    assert widget.focus.value == pytest.approx(radii[50, 50], abs=0.01)
    assert widget.pick.text == PICK
    assert list(viewer.mouse_drag_callbacks) == before
    assert seeds.mode == "paint"
    click(viewer, (100, 200))
    assert widget.focus.value == pytest.approx(radii[50, 50], abs=0.01)


def test_waiting_for_a_click_ends_with_another_press_and_with_the_widget(
    window, docked, qtbot, texture
):
    window.add_image(texture, name="leaf")
    window.add_image(np.ones(texture.shape), name="theirs", contrast_limits=(0, 2))
    widget = docked(ChangeFocusWidget)
    widget.image.value = window.layers["leaf"]
    widget.blur_map.value = window.layers["theirs"]
    before = list(window.mouse_drag_callbacks)
    for waiting in (True, False, True):
        widget.pick.native.click()
        assert (list(window.mouse_drag_callbacks) != before) == waiting
    click(window, (5, 5))
    assert widget.focus.value == 1
    widget.pick.native.click()
    window.window.remove_dock_widget("all")
    widget.native.deleteLater()
    qtbot.waitUntil(lambda: list(window.mouse_drag_callbacks) == before)


def test_focus_is_picked_from_the_map_that_was_estimated(
    viewer, opened, finish, qtbot, method, texture, messages
):
    viewer.add_image(texture, name="leaf")
    widget = opened(ChangeFocusWidget)
    widget.pick_focus()
    assert "no blur map to read the focus from" in messages()[0]
    assert widget.pick.text == PICK
    finish(widget)
    viewer.dims.ndisplay = 3
    widget.pick_focus()
    assert "Switch the viewer to 2-D" in messages()[1]
    viewer.dims.ndisplay = 2
    widget.pick_focus()
    click(viewer, (5, 5))
    assert widget.focus.value == method.radius
    qtbot.waitUntil(lambda: widget._running is None)
    assert method.refocusings[-1]["focus"] == method.radius


def test_value_of_a_layer_is_read_where_it_lies(viewer):
    stack = np.arange(24.0).reshape(2, 3, 4)
    stack[0, 0, 0] = np.nan
    layer = viewer.add_image(stack, scale=(5, 1, 1), translate=(0, 10, 0), contrast_limits=(0, 9))
    assert value_at(layer, (5, 12.4, 2.6)) == stack[1, 2, 3]
    assert value_at(layer, (0, 10, 0)) is None
    assert value_at(layer, (0, 9, 0)) is None
    assert value_at(layer, (12, 10, 0)) is None


def test_surface_comes_if_it_is_wanted(viewer, opened, done, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = ready(opened(DefocusWidget))
    widget.depth.surface.value = True
    widget.depth.min_confidence.value = 0.2
    done(widget, "estimate_depth")
    assert names(viewer)[-2:] == ["leaf depth (m)", "leaf depth surface"]
    assert viewer.dims.ndisplay == 2
    assert "Not known on 20%" in widget.status.value


def test_file_of_the_image_is_offered_and_read(window, docked, tmp_path, texture, messages):
    exif = PIL.Image.Exif()
    exif.get_ifd(0x8769).update({0x829D: 2.8, 0x920A: 35.0, 0xA405: 52})
    file = tmp_path / "photograph.jpg"
    PIL.Image.fromarray((255 * texture).astype(np.uint8)).save(file, exif=exif)
    window.open(file, plugin="napari")
    widget = docked(DefocusWidget)
    assert widget.depth.thin_lens.file.value == file
    assert widget.depth.thin_lens.focal_length.value == "", "nothing is read before it is asked for"
    widget.depth.thin_lens.read_button.native.click()
    assert widget.depth.thin_lens.focal_length.value == "35"
    assert "Not noted: focus distance" in widget.status.value
    window.add_image(texture, name="leaf")
    widget.image.value = window.layers["leaf"]
    assert widget.depth.thin_lens.file.value is None
    widget.depth.thin_lens.read_button.native.click()
    assert "Choose the photograph's file first" in messages()[0]
    widget.depth.thin_lens.file.value = tmp_path / "chosen.jpg"
    widget.image.value = window.layers["photograph"]
    assert widget.depth.thin_lens.file.value == tmp_path / "chosen.jpg", "it was chosen by hand"


@pytest.mark.parametrize("widget_class", [ChangeFocusWidget, DefocusWidget])
def test_widget_says_what_one_picture_cannot_tell(opened, widget_class):
    widget = opened(widget_class)
    form = getattr(widget, "depth", widget)
    assert "One picture cannot tell on which side" in form.side_note.value
    assert form.side.value == "far"


@WAYS
def test_no_image_is_said_in_plain_words(opened, messages, dock, action):
    assert getattr(opened(dock), action)() is None
    assert messages() == ["There is no image to analyse. Open an image first."]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda w: setattr(w.settings.noise_variance, "value", "low"), "Type a number such as"),
        (lambda w: setattr(w.settings.lens.lens, "value", "measured"), "Choose the file of the"),
        (
            lambda w: setattr(w.restoration.tv_weight, "value", "much"),
            "The smoothing is “much”. Type a number such as 1e-3, or leave it empty",
        ),
        (
            lambda w: setattr(w.restoration.tv_weight, "value", "0"),
            "The smoothing is 0. Type a number above 0",
        ),
    ],
)
def test_fields_that_cannot_be_are_said_before_any_work(
    viewer, opened, method, texture, messages, change, said
):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    change(widget)
    assert widget.restore() is None
    assert said in messages()[0]
    assert not method.estimations


def test_lens_without_numbers_is_said_before_any_work(viewer, opened, method, texture, messages):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    assert widget.estimate_depth() is None
    ready(widget).depth.thin_lens.focus_distance.value = "inf"
    assert widget.estimate_depth() is None
    first, second = messages()
    assert "Fill in the focal length" in first
    assert "Nothing lies behind a focus at infinity" in second
    assert not method.estimations


def test_picture_that_is_no_map_is_said_in_plain_words(
    viewer, opened, done, method, texture, messages
):
    viewer.add_image(texture, name="leaf")
    theirs = viewer.add_image(200 * texture, name="theirs")
    widget = opened(DefocusWidget)
    widget.image.value = viewer.layers["leaf"]
    choose_map(widget, theirs)
    done(widget, "restore")
    assert messages()[0].startswith("Cannot analyse “leaf”: its blur map “theirs” goes up to")
    assert names(viewer) == ["leaf", "theirs"]


@WAYS
def test_cancel_ends_the_work_at_its_next_report_and_leaves_no_layer(
    viewer, opened, qtbot, endless_method, texture, messages, dock, action
):
    viewer.add_image(texture, name="leaf")
    widget = ready(opened(dock))
    run = getattr(widget, action)()
    qtbot.waitUntil(lambda: widget.status.value == "Estimating blur")
    assert widget.run() is run
    with qtbot.waitSignal(run.finished):
        widget.cancel_button.native.click()
    assert names(viewer) == ["leaf"]
    assert messages() == []


@WAYS
def test_removed_layer_ends_its_run_without_a_word(
    viewer, opened, qtbot, endless_method, texture, messages, dock, action
):
    viewer.add_image(texture, name="leaf")
    widget = ready(opened(dock))
    run = getattr(widget, action)()
    qtbot.waitUntil(lambda: bool(endless_method.estimations))
    with qtbot.waitSignal(run.finished):
        viewer.layers.remove("leaf")
    assert names(viewer) == []
    assert messages() == []


def test_picture_replaced_while_it_runs_gets_no_result(
    viewer, opened, qtbot, method, texture, messages, monkeypatch
):
    layer = viewer.add_image(texture, name="leaf")
    go_on = []

    def restore_all_in_focus(image, blur_map, *, progress, **arguments):
        while not go_on:
            progress("Taking the blur away", 0.2)
            time.sleep(0.01)
        return image, RestorationFit(1e-5, 2e-3, 0.0, np.zeros(image.shape[:2], np.float32))

    monkeypatch.setitem(vars(napari_defocus), "restore_all_in_focus", restore_all_in_focus)
    widget = opened(DefocusWidget)
    run = widget.restore()
    layer.data = texture[:50].copy()
    with qtbot.waitSignal(run.finished):
        go_on.append(True)
    assert names(viewer) == ["leaf"]
    assert "changed while" in messages()[0]
