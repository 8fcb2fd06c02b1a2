from pathlib import Path

import numpy as np
import pytest
from napari.components import ViewerModel
from napari.utils.notifications import notification_manager

import napari_defocus
from napari_defocus import Annulus, MeasuredPSF, simulate_defocus
from napari_defocus.widgets.docks.calibrate import CalibrateWidget
from napari_defocus.widgets.docks.single_steps import BlurMapWidget
from napari_defocus.widgets.jobs.calibration import Calibration, numbers, planes_of
from napari_defocus.widgets.layers.image_layers import NotAnalysableError
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, made_by_us

RING = Annulus(0.4)


def lamps(radius, peak=0.8, dtype=np.float32):
    """Two lamps through a mirror lens."""
    picture = np.zeros((61, 121))
    kernel = RING.kernel(radius)
    reach = len(kernel) // 2
    for column in (30, 90):
        picture[30 - reach : 31 + reach, column - reach : column + reach + 1] = kernel
    return (peak * picture / picture.max()).astype(dtype)


@pytest.fixture
def viewer():
    return ViewerModel()


@pytest.fixture
def file(tmp_path):
    return tmp_path / "mirror.npz"


def measure(layers, file, **options):
    planes = [plane for layer in layers for plane in planes_of(layer)]
    return Calibration(planes=planes, file=file, **options).run()


def assert_is_the_ring(lens, within=0.05):
    ring = RING.kernel(5)
    outside = (lens.kernels.shape[1] - len(ring)) // 2
    assert np.abs(lens.kernels[-1] - np.pad(ring, outside)).sum() < within


# --- without a window -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("peak", "dtype"), [(0.8, np.float32), (3000, np.float64), (200, np.uint8), (4095, np.uint16)]
)
def test_lens_is_measured_whatever_the_pictures_are_stored_as(viewer, file, peak, dtype):
    layers = [viewer.add_image(lamps(radius, peak, dtype)) for radius in (5, 2)]
    measure(layers, file)
    assert_is_the_ring(MeasuredPSF.load(file))


def test_stack_is_one_setting_a_plane(viewer, file):
    stack = viewer.add_image(np.stack([lamps(radius) for radius in (1, 3, 5)]), name="focus")
    measure([stack], file, scales=[1, 3, 5])
    lens = MeasuredPSF.load(file)
    assert lens.scales.tolist() == [1, 3, 5]
    assert lens.provenance["names"] == ["focus 0", "focus 1", "focus 2"]
    assert_is_the_ring(lens)


@pytest.mark.parametrize("one_for_each", [False, True])
def test_sharp_picture_for_all_or_one_for_each(viewer, file, gravel, one_for_each):
    blurred = [
        viewer.add_image(simulate_defocus(gravel, np.full(gravel.shape, radius), psf=RING))
        for radius in (2.0, 5.0)
    ]
    sharp = viewer.add_image(np.stack([gravel] * 2) if one_for_each else gravel)
    measure(blurred, file, sharp=planes_of(sharp))
    assert_is_the_ring(MeasuredPSF.load(file), within=0.2)


def test_kernels_come_as_a_stack_with_scales_and_the_size_of_pixels(viewer, file):
    layers = [
        viewer.add_image(lamps(radius), scale=(0.5, 0.25), units=("um", "um")) for radius in (2, 5)
    ]
    [(kernels, keywords, kind)] = measure(layers, file, scales=[2, 5])
    assert (kind, keywords["name"]) == ("image", "mirror kernels")
    assert kernels.shape == (2, 11, 11)
    np.testing.assert_allclose(kernels.max(axis=(1, 2)), 1)
    assert keywords["scale"] == (1, 0.5, 0.25)
    assert len(keywords["units"]) == 3
    made = keywords["metadata"][METADATA_KEY]
    assert made["scales"] == [2, 5]
    assert made["file"] == str(file)
    assert made["provenance"]["scales_were"] == "given"


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        ({"count": 1}, "two pictures or more"),
        ({"scales": [1, 2, 3]}, "3 scales for 2 pictures"),
        ({"sharp": 3}, "3 sharp pictures for 2 blurred ones"),
        ({"name": "mirror.txt"}, "must end in .npz"),
        ({"name": "."}, "must end in .npz"),
        ({"name": "none/mirror.npz"}, "there is no folder"),
        ({"name": "taken.npz"}, "exists already .a tick at “overwrite” overwrites it"),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(viewer, tmp_path, options, saying):
    (tmp_path / "taken.npz").write_bytes(b"mine")
    [plane] = planes_of(viewer.add_image(lamps(2)))
    with pytest.raises(ValueError, match=saying):
        Calibration(
            planes=[plane] * options.get("count", 2),
            sharp=[plane] * options.get("sharp", 0),
            scales=options.get("scales"),
            file=tmp_path / options.get("name", "mirror.npz"),
        )
    assert (tmp_path / "taken.npz").read_bytes() == b"mine"


def test_file_is_replaced_if_that_is_wanted(viewer, file):
    file.write_bytes(b"mine")
    measure([viewer.add_image(lamps(radius)) for radius in (2, 5)], file, overwrite=True)
    assert_is_the_ring(MeasuredPSF.load(file))


def test_unusable_picture_is_called_by_its_name_and_nothing_is_saved(viewer, file):
    layers = [viewer.add_image(lamps(2)), viewer.add_image(np.zeros((61, 121)), name="night")]
    with pytest.raises(ValueError, match="“night” shows no usable point source"):
        measure(layers, file)
    assert not file.exists()


def test_layer_of_more_axes_is_refused(viewer):
    with pytest.raises(NotAnalysableError, match="“movie” has 4 axes"):
        planes_of(viewer.add_image(np.zeros((2, 3, 20, 20)), name="movie"))


def test_scales_are_read_with_commas_or_blanks():
    assert numbers("1, 2.5,4") == numbers("1 2.5 4") == [1, 2.5, 4]
    assert numbers("  ") is None
    with pytest.raises(ValueError, match="“1; 2”"):
        numbers("1; 2")


# --- the widget -----------------------------------------------------------------------------


@pytest.fixture
def widget(viewer, qtbot, file):
    for radius in (2, 5):
        viewer.add_image(lamps(radius), name=f"lamps {radius}")
    viewer.add_image(np.ones((61, 121)), name="other")
    widget = CalibrateWidget(viewer)
    qtbot.addWidget(widget.native)
    viewer.layers.selection = {viewer.layers["lamps 2"], viewer.layers["lamps 5"]}
    widget.file.value = file
    return widget


@pytest.fixture
def messages():
    notification_manager.records.clear()
    return lambda: [record.message for record in notification_manager.records]


@pytest.mark.display
def test_selected_layers_are_shown_and_measured(viewer, widget, qtbot, file):
    assert widget.pictures.value == "lamps 2, lamps 5"
    with qtbot.waitSignal(widget.run().finished):
        pass
    lens = MeasuredPSF.load(file)
    assert_is_the_ring(lens)
    layer = viewer.layers["mirror kernels"]
    assert made_by_us(layer) == "measured PSF"
    np.testing.assert_allclose(layer.metadata[METADATA_KEY]["scales"], lens.scales)
    assert "Saved in mirror.npz" in widget.status.value
    assert widget.pictures.value == "lamps 2, lamps 5", "ready for another measurement"


@pytest.mark.display
def test_lens_just_measured_is_the_one_that_other_widgets_take(viewer, widget, qtbot, file):
    with qtbot.waitSignal(widget.run().finished):
        pass
    other = BlurMapWidget(viewer)
    qtbot.addWidget(other.native)
    assert "mirror kernels" not in [layer.name for layer in other.image.choices]
    other.settings.lens.lens.value = "measured"
    settings = other.settings.map_settings()
    assert settings.psf == str(file)
    assert settings.family().max_scale == MeasuredPSF.load(file).max_scale


@pytest.mark.display
def test_sharp_picture_is_none_of_the_blurred_ones(viewer, widget):
    viewer.layers.selection = set(viewer.layers)
    assert widget.pictures.value == "lamps 2, lamps 5, other"
    widget.sharp.value = viewer.layers["other"]
    assert widget.pictures.value == "lamps 2, lamps 5"
    assert [plane.name for plane in widget.calibration().sharp] == ["other"]
    widget.sharp.value = None
    assert widget.pictures.value == "lamps 2, lamps 5, other"


@pytest.mark.display
def test_what_is_missing_is_said_in_plain_words(viewer, widget, messages, file):
    viewer.layers.selection = {viewer.layers["other"]}
    assert widget.run() is None
    viewer.layers.selection = set(viewer.layers)
    widget.scales.value = "one"
    assert widget.run() is None
    widget.scales.value = "1, 2"
    assert widget.run() is None
    widget.scales.value = ""
    widget.file.value = ""
    assert widget.run() is None
    said = ["two pictures or more", "are “one”", "2 scales for 3", "Choose a file"]
    for message, words in zip(messages(), said, strict=True):
        assert words in message
    assert not file.exists()


@pytest.mark.display
def test_full_disk_is_said_in_plain_words(viewer, widget, qtbot, messages, monkeypatch, file):
    def full_disk(self, path):
        raise OSError(f"cannot write {path}: No space left on device")

    monkeypatch.setattr(MeasuredPSF, "save", full_disk)
    with qtbot.waitSignal(widget.run().finished):
        pass
    assert "No space left" in messages()[0]
    assert "mirror kernels" not in [layer.name for layer in viewer.layers]


@pytest.mark.display
@pytest.mark.parametrize("how", ["cancel", "remove"])
def test_cancel_or_removing_a_picture_saves_nothing(
    viewer, widget, qtbot, monkeypatch, messages, file, how, endless
):
    def calibrate_psf(pictures, *, progress, **arguments):
        endless.work("Measuring the PSF", progress)

    monkeypatch.setitem(vars(napari_defocus), "calibrate_psf", calibrate_psf)
    run = widget.run()
    qtbot.waitUntil(lambda: widget.status.value == "Measuring the PSF")
    with qtbot.waitSignal(run.finished):
        if how == "cancel":
            widget.cancel_button.native.click()
        else:
            viewer.layers.remove("lamps 5")
    assert not file.exists()
    assert messages() == []
    assert widget.run_button.enabled


@pytest.mark.display
def test_every_field_explains_itself(widget):
    for field in (widget.pictures, widget.sharp, widget.scales, widget.file, widget.overwrite):
        assert len(field.tooltip) > 40


@pytest.mark.display
def test_closed_widget_no_longer_follows_the_selection(make_napari_viewer_proxy, messages):
    window = make_napari_viewer_proxy()
    window.add_image(lamps(2), name="lamps")
    _, widget = window.window.add_plugin_dock_widget("napari-defocus", "Calibrate a lens")
    assert widget.pictures.value == "lamps"
    window.window.remove_dock_widget("all")
    widget.native.deleteLater()
    window.layers.selection.clear()
    window.layers.remove("lamps")
    assert messages() == []
    assert Path(str(widget.file.value or "")).suffix == ""
