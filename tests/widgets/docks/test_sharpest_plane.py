"""The sharpest plane of each pixel, as layers and as a widget."""

import dask.array as da
import numpy as np
import pytest
from skimage.data import camera

from napari_defocus import Cancelled, StackAlignment, simulate_defocus
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.docks.sharpest_plane import SharpestPlaneWidget
from napari_defocus.widgets.jobs import focus_stacking as best_focus
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.focus_stacking import FocusStacking
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

FOCUS = np.broadcast_to(np.linspace(1, 5, 140), (90, 140))


@pytest.fixture(scope="module")
def sweep():
    picture = camera()[:90, 60:200]
    planes = [simulate_defocus(picture, abs(z - FOCUS)) for z in range(7)]
    return (255 * np.clip(planes, 0, 1)).astype(np.uint8)


@pytest.fixture(autouse=True)
def _here(monkeypatch):
    """No other process: it would import everything for itself."""

    def here(function, *arguments, progress, **keywords):
        return function(*arguments, progress=progress, **keywords)

    monkeypatch.setattr(best_focus, "run_elsewhere", here)


def found_of(viewer, layer, axis, progress=lambda step, done: None):
    wanted = FocusStacking(
        plane=shown_plane(layer, viewer.dims), axis=axis, settings=MapSettings(), px_per_plane=1.0
    )
    return wanted.run(JobCache(), progress)


def test_positions_picture_and_confidence_lie_on_the_stack_at_all_its_planes(viewer, sweep):
    layer = viewer.add_image(
        sweep,
        name="sweep",
        scale=(5, 0.5, 0.25),
        translate=(1, 2, 3),
        units=("um", "um", "um"),
        axis_labels=("z", "y", "x"),
    )
    results = found_of(viewer, layer, 0)
    picture, position, sure, height = add_results(viewer, results.layers)
    assert [each.name for each in (picture, position, sure, height)] == [
        "sweep sharpest",
        "sweep best focus (plane)",
        "sweep best focus confidence",
        "sweep height of best focus (µm)",
    ]
    np.testing.assert_allclose(height.data, 5 * position.data, rtol=1e-6)
    assert tuple(height.contrast_limits) == (0, 30)
    assert picture.data.dtype == np.uint8
    assert np.median(np.abs(position.data - FOCUS)) < 0.3
    assert tuple(position.contrast_limits) == (0, 6)
    assert position.colorbar.visible
    for each in (picture, position, sure, height):
        assert each.data.shape == (90, 140)
        assert tuple(each.scale) == (0.5, 0.25)
        assert tuple(each.translate) == (2, 3)
        assert [str(unit) for unit in each.units] == ["micrometer"] * 2
        assert each.axis_labels == ("y", "x")
        assert each.metadata[METADATA_KEY]["px_per_plane"] == 1
    assert "The blur grows by 1.00 px a plane (given)" in results.summary
    again = add_results(viewer, results.layers)
    assert again == [picture, position, sure, height]


def test_focus_along_one_of_two_sliders_of_colours_in_any_order(viewer, sweep):
    movie = np.repeat(sweep.transpose(1, 0, 2)[..., None], 3, axis=-1)
    movie = np.stack([np.zeros_like(movie), movie], axis=1)
    layer = viewer.add_image(da.from_array(movie, chunks=64), rgb=True, scale=(1, 2, 3, 4))
    viewer.dims.order = (1, 2, 0, 3)
    viewer.dims.set_current_step((1, 2), (1, 4))
    picture, position, _ = add_results(viewer, found_of(viewer, layer, 2).layers)
    assert picture.rgb
    assert picture.data.shape == (90, 1, 1, 140, 3)
    assert tuple(picture.scale) == (1, 2, 3, 4)
    assert tuple(picture.translate) == (0, 2, 12, 0)
    assert np.median(np.abs(position.data[:, 0, 0] - FOCUS)) < 0.3


def test_planes_are_read_one_at_a_time_and_no_other_time_point(viewer, sweep):
    read = []

    def plane(block_info=None):
        at = tuple(start for start, _ in block_info[None]["array-location"])
        read.append(at[:2])
        return sweep[at[1]][None, None]

    chunks = ((1, 1), (1,) * 7, (90,), (140,))
    data = da.map_blocks(plane, chunks=chunks, dtype=np.uint8, meta=np.empty((0,) * 4, np.uint8))
    layer = viewer.add_image(data, contrast_limits=(0, 255))
    read.clear()
    found_of(viewer, layer, 1)
    assert {t for t, _ in read} == {int(viewer.dims.point[0])}
    assert all(read.count((read[0][0], z)) <= 5 for z in range(7))


def test_cancel_ends_it(viewer, sweep):
    layer = viewer.add_image(sweep)

    def stop(step, done):
        if done > 0.1:
            raise Cancelled

    with pytest.raises(Cancelled):
        found_of(viewer, layer, 0, stop)


def test_other_stack_is_put_together_at_the_same_positions(viewer, sweep):
    layer = viewer.add_image(sweep, name="sweep")
    other = viewer.add_image(sweep.astype(np.uint16) * 100, name="other")
    wanted = FocusStacking(
        plane=shown_plane(layer, viewer.dims), axis=0, settings=MapSettings(), px_per_plane=1.0,
        blend=False, also=shown_plane(other, viewer.dims),
    )  # fmt: skip
    picture, *_, of_other = add_results(viewer, wanted.run(JobCache()).layers)
    assert of_other.name == "other sharpest"
    assert of_other.data.dtype == np.uint16
    np.testing.assert_array_equal(of_other.data, picture.data.astype(np.uint16) * 100)
    short = viewer.add_image(sweep[1:], name="short")
    with pytest.raises(NotAnalysableError, match="the other stack has 6 planes"):
        FocusStacking(
            plane=shown_plane(layer, viewer.dims), axis=0, settings=MapSettings(),
            also=shown_plane(short, viewer.dims),
        )  # fmt: skip


def test_flicker_is_told_in_the_summary(viewer, sweep):
    flickering = sweep.astype(np.float32)
    flickering[3] *= 1.2
    results = found_of(viewer, viewer.add_image(flickering), 0)
    assert "Planes were made equally bright" in results.summary
    assert "none was aligned" in results.summary


def test_what_is_no_stack_is_refused_in_words(viewer, sweep):
    layer = viewer.add_image(sweep[:1])
    with pytest.raises(NotAnalysableError, match="single plane"):
        found_of(viewer, layer, 0)
    with pytest.raises(NotAnalysableError, match="slider"):
        found_of(viewer, layer, 1)


@pytest.mark.display
def test_form_runs_it(viewer, opened, finish, sweep):
    viewer.add_image(sweep[0], name="photo")
    viewer.add_image(np.stack([sweep, sweep]), name="movie", axis_labels=("t", "z", "y", "x"))
    viewer.add_image(sweep, name="sweep", scale=(5, 2, 3), axis_labels=("z", "y", "x"))
    widget = opened(SharpestPlaneWidget)
    assert [layer.name for layer in widget.image.choices] == ["movie", "sweep"]
    assert widget.image.value.name == "sweep"
    assert len(widget.along.choices) == 1
    widget.image.value = viewer.layers["movie"]
    assert widget.along.value == 1
    widget.image.value = viewer.layers["sweep"]
    widget.px_per_plane.value = "nonsense"
    assert widget.run() is None
    widget.px_per_plane.value = ""
    widget.align.value, widget.peak.value = False, "first"
    assert widget.wanted().align is False
    assert widget.wanted().peak == "first"
    finish(widget)
    assert tuple(viewer.layers["sweep sharpest"].scale) == (2, 3)
    assert viewer.layers.selection.active.name == "sweep sharpest"
    assert "The blur grows by" in widget.status.value
    choices = widget.align, widget.match_brightness, widget.blend, widget.peak, widget.also
    choices += (*widget.alignment.fields(),)
    for field in (widget.image, widget.along, widget.px_per_plane, *choices):
        assert len(field.tooltip) > 40


@pytest.mark.display
def test_alignment_is_saved_and_used_for_another_channel(
    viewer, opened, finish, sweep, tmp_path, messages
):
    drifting = np.stack([np.roll(plane, 2 * z, axis=1) for z, plane in enumerate(sweep)])
    both = np.stack([drifting, np.full_like(drifting, 9)])
    viewer.add_image(both, name="stack", axis_labels=("c", "z", "y", "x"))
    widget, file = opened(SharpestPlaneWidget), tmp_path / "motion.json"
    assert not widget.alignment.save_button.enabled
    widget.save_alignment(file)
    assert "no alignment to save yet" in messages()[0]
    viewer.dims.set_current_step(0, 0)
    finish(widget)
    assert widget.alignment.save_button.enabled
    widget.save_alignment(file)
    assert "Saved in motion.json: shifts up to" in widget.status.value
    saved = StackAlignment.load(file)
    np.testing.assert_allclose(np.diff(saved.shift[:, 1]), 2, atol=0.3)
    widget.save_alignment(file)
    assert "exists already" in messages()[1]

    viewer.dims.set_current_step(0, 1)
    widget.alignment.use.value = file
    assert not widget.align.enabled
    finish(widget)
    made = viewer.layers["stack sharpest"].metadata[METADATA_KEY]
    assert made["settings"]["align"] == "as given"
    np.testing.assert_allclose(StackAlignment.from_dict(made["alignment"]).shift, saved.shift)
    assert "shifts up to" in widget.status.value

    widget.alignment.use.value = tmp_path / "none.json"
    assert widget.run() is None
    assert "there is no such file" in messages()[2]
    StackAlignment.still((50, 60), 7).save(tmp_path / "small.json")
    widget.alignment.use.value = tmp_path / "small.json"
    assert widget.run() is None
    assert "alignment is of 7 planes of 50 x 60 px; the stack has 7 of 90 x 140 px" in messages()[3]
    widget.alignment.use.value = None
    assert widget.align.enabled


def labelled(viewer, sweep, axes):
    """Add a stack as the second of two channels, or times, whose axes have several letters."""
    values, order = sweep, "zyx"
    for axis in axes.lower():
        if axis not in order:
            two = axis.upper() in axes
            values = np.stack([values[:, ::-1], values], -1) if two else values[..., None]
            order += axis
    values = values.transpose([order.index(axis) for axis in axes.lower()])
    return viewer.add_image(values, name="stack", axis_labels=tuple(axes.lower()))


def test_times_are_taken_for_planes_with_a_word(viewer, sweep):
    layer = viewer.add_image(sweep, name="sweep", axis_labels=("time", "y", "x"))
    assert "“time” was taken for focus" in found_of(viewer, layer, 0).summary


def is_shown(field):
    return not field.native.isHidden()


@pytest.mark.display
@pytest.mark.parametrize(
    ("axes", "along", "fields"),
    [
        ("tczyx", [2], []),
        ("tCzyx", [2], ["channel"]),
        ("TCzyx", [2, 0], ["channel", "time"]),
        ("zTyx", [0, 1], ["time"]),
        ("zCyx", [0], ["channel"]),
    ],
)
def test_channel_and_time_are_asked_for_where_there_are_several(
    viewer, opened, sweep, axes, along, fields
):
    labelled(viewer, sweep, axes)
    widget = opened(SharpestPlaneWidget)
    assert list(widget.along.choices) == along
    assert is_shown(widget.along) == (len(along) > 1)
    assert [each.name for each in (widget.channel, widget.time) if is_shown(each)] == fields
    for field in (getattr(widget, name) for name in fields):
        assert field.max == 1
        axis = axes.lower().index(field.name[0])
        field.value = 1
        assert viewer.dims.current_step[axis] == 1
        viewer.dims.set_current_step(axis, 0)
        assert field.value == 0
        field.value = 1
    wanted = widget.wanted()
    assert (wanted.axis, wanted.count) == (axes.lower().index("z"), 7)
    np.testing.assert_array_equal(np.squeeze(np.asarray(wanted._stack())), sweep)
    if len(along) > 1:
        widget.along.value = axes.lower().index("t")
        assert not is_shown(widget.time)


@pytest.mark.display
def test_channels_are_no_planes(viewer, opened, messages, sweep):
    layer = viewer.add_image(sweep[:3], name="stains", axis_labels=("channel", "y", "x"))
    widget = opened(SharpestPlaneWidget)
    assert widget.run() is None
    assert "channels are no planes through focus" in messages()[-1]
    with pytest.raises(NotAnalysableError, match="channels are no planes"):
        found_of(viewer, layer, 0)
