import dask.array as da
import numpy as np
import pytest
from napari.components import ViewerModel
from napari.layers import Image, Labels
from napari.layers._source import layer_source

from napari_defocus import __version__
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.layers import image_layers as layers
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    confidence_layer,
    in_focus_layer,
    not_trusted_layer,
)
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    METADATA_KEY,
    layer_of_result,
    made_by_us,
)

PLACED = {
    "scale": (0.5, 0.25),
    "translate": (3.0, -4.0),
    "rotate": 20.0,
    "shear": (0.1,),
    "affine": [[1.1, 0.2, 5.0], [0.0, 0.9, -2.0], [0.0, 0.0, 1.0]],
    "units": ("um", "um"),
    "axis_labels": ("y", "x"),
}


@pytest.fixture
def viewer():
    return ViewerModel()


def plane_of(layer, viewer):
    return shown_plane(layer, viewer.dims)


def results_of(plane, radius=2.5, threshold=2.0, max_radius=8.0):
    shape = plane.read().shape[:2]
    estimation = MapSettings(max_radius=max_radius)
    mask = MaskSettings(threshold=threshold)
    return [
        blur_map_layer(plane, np.full(shape, radius, np.float32), estimation, 3e-5),
        in_focus_layer(plane, np.ones(shape, np.uint8), mask, estimation, 3e-5),
    ]


def corners_in_world(layer):
    height, width = layer.data.shape[-2:]
    lead = (0,) * (layer.ndim - 2)
    return [layer.data_to_world((*lead, y, x)) for y in (0, height - 1) for x in (0, width - 1)]


def test_results_lie_exactly_on_the_picture(viewer, texture):
    picture = viewer.add_image(texture, name="leaf", **PLACED)
    blur_map, mask = add_results(viewer, results_of(plane_of(picture, viewer)))
    for layer in (blur_map, mask):
        np.testing.assert_allclose(layer.scale, picture.scale)
        np.testing.assert_allclose(layer.affine.affine_matrix, picture.affine.affine_matrix)
        np.testing.assert_allclose(corners_in_world(layer), corners_in_world(picture))
        assert layer.units == picture.units
        assert layer.axis_labels == ("y", "x")


def test_blur_map_has_one_colour_range_and_a_colour_bar(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    blur_map, _ = add_results(viewer, results_of(plane, radius=2.5, max_radius=6.0))
    assert isinstance(blur_map, Image)
    assert blur_map.name == "leaf blur (px)"
    assert tuple(blur_map.contrast_limits) == (0.0, 8.0)
    assert tuple(blur_map.contrast_limits_range) == (0.0, 8.0)
    assert blur_map.colorbar.visible
    assert blur_map.name_overlay.visible, "several bars are told apart"
    assert blur_map.name_overlay.position == blur_map.colorbar.position


def test_colour_range_of_much_blur_reaches_as_far_as_the_map(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    blur_map, _ = add_results(viewer, results_of(plane, radius=11.3, max_radius=64.0))
    assert tuple(blur_map.contrast_limits) == (0.0, 12.0)
    assert tuple(blur_map.contrast_limits_range) == (0.0, 12.0)


@pytest.mark.parametrize("psf", ["polygon:6", "gaussian", "generalized-gaussian:4"])
def test_blur_map_is_in_px_of_radius_whatever_the_lens(viewer, texture, psf):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    settings = MapSettings(psf=psf, max_radius=16.0)
    blur_map = blur_map_layer(plane, np.full(texture.shape, 11.3), settings, 3e-5)
    [layer] = add_results(viewer, [blur_map])
    assert layer.name == "leaf blur (px)"
    assert tuple(layer.contrast_limits) == (0.0, 12.0)
    assert layer.metadata[METADATA_KEY]["scale"] == "blur radius (px)"


def test_map_of_another_lens_takes_the_place_of_the_map(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    for psf in ("disc", "annulus:0.5"):
        layer = blur_map_layer(plane, np.ones(texture.shape), MapSettings(psf=psf), 3e-5)
        add_results(viewer, [layer])
    assert [layer.name for layer in viewer.layers] == ["leaf", "leaf blur (px)"]
    assert viewer.layers[1].metadata[METADATA_KEY]["settings"]["psf"] == "annulus:0.5"


def test_confidence_and_what_is_not_trusted_lie_on_the_picture(viewer, texture):
    picture = viewer.add_image(texture, name="leaf", **PLACED)
    values = np.linspace(0, 1, texture.size, dtype=np.float32).reshape(texture.shape)
    result = confidence_layer(plane_of(picture, viewer), values, MapSettings(), 3e-5)
    confidence, cover = add_results(viewer, [result, not_trusted_layer(result, 0.25)])
    assert (confidence.name, cover.name) == ("leaf confidence", "leaf not trusted")
    for layer in (confidence, cover):
        np.testing.assert_allclose(corners_in_world(layer), corners_in_world(picture))
        assert layer.units == picture.units
        assert layer.axis_labels == ("y", "x")
    assert tuple(confidence.contrast_limits) == (0.0, 1.0)
    assert confidence.colorbar.visible
    assert not confidence.visible
    assert isinstance(cover, Labels)
    np.testing.assert_array_equal(cover.data, values < 0.25)
    assert cover.metadata[METADATA_KEY]["min_confidence"] == 0.25
    color = cover.colormap.map(np.array([0, 1]))
    assert color[0, 3] == 0
    assert np.ptp(color[1, :3]) == 0, "grey"
    again = not_trusted_layer(confidence.as_layer_data_tuple(), 0.5)
    assert add_results(viewer, [again]) == [cover]
    np.testing.assert_array_equal(cover.data, values < 0.5)


def test_map_is_read_through_what_covers_it_and_no_other_blur_is_read(viewer, texture):
    plane = plane_of(viewer.add_image(texture), viewer)
    blur_map, _ = add_results(viewer, results_of(plane))
    result = confidence_layer(plane, texture, MapSettings(), 3e-5)
    [cover] = add_results(viewer, [not_trusted_layer(result, 0.5)])
    blur = blur_map.colormap.map(np.linspace(0, 1, 81))[:, :3]
    veil = cover.colormap.map(np.array([1]))[0, :3]
    seen = (1 - cover.opacity) * blur + cover.opacity * veil
    away = np.linalg.norm(seen[:, None] - blur, axis=2)
    assert away.min() > 0.2, "no colour of the map"
    steps = np.linalg.norm(seen[10:] - seen[:-10], axis=1)
    assert steps.min() > 0.04, "1 px more or less is seen"


def test_results_are_no_pictures_to_analyse(viewer, texture):
    picture = viewer.add_image(texture, name="leaf")
    results = add_results(viewer, results_of(plane_of(picture, viewer)))
    assert made_by_us(picture) is None
    assert [made_by_us(layer) for layer in results] == ["blur map", "in focus"]
    picture.metadata["napari_defocus"] = "somebody's note"
    assert made_by_us(picture) is None


def test_mask_colours_what_is_in_focus_and_nothing_else(viewer, texture):
    _, result = results_of(plane_of(viewer.add_image(texture), viewer))
    [mask] = add_results(viewer, [result])
    assert isinstance(mask, Labels)
    np.testing.assert_array_equal(mask.colormap.map(np.array([0, 1]))[:, 3], [0, 1])
    assert 0.2 <= mask.opacity <= 0.6
    assert mask.contour == 0


def test_mask_on_a_map_is_an_outline(viewer, texture):
    _, mask = add_results(viewer, results_of(plane_of(viewer.add_image(texture), viewer)))
    assert mask.contour > 0
    assert mask.opacity == 1


def test_results_say_how_they_were_made(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    blur_map, mask = add_results(viewer, results_of(plane, threshold=1.5))
    made = blur_map.metadata[METADATA_KEY]
    assert made["source"] == "leaf"
    assert made["version"] == __version__
    assert made["noise_variance"] == 3e-5
    assert made["settings"]["max_radius"] == 8.0
    assert made["settings"]["noise_variance"] is None
    assert mask.metadata[METADATA_KEY]["settings"]["threshold"] == 1.5


def test_second_run_updates_the_layers_and_keeps_the_users_colours(viewer, texture):
    picture = viewer.add_image(texture, name="leaf", scale=(2, 2))
    first = add_results(viewer, results_of(plane_of(picture, viewer)))
    first[0].colormap, first[1].opacity = "magma", 0.9
    picture.scale = (3, 3)
    second = add_results(viewer, results_of(plane_of(picture, viewer), radius=12, max_radius=16))
    assert second == first
    assert len(viewer.layers) == 3
    assert (first[0].data == 12).all()
    assert tuple(first[0].contrast_limits) == (0.0, 12.0)
    assert first[0].colormap.name == "magma"
    assert first[1].opacity == 0.9
    np.testing.assert_allclose(first[1].scale, (3, 3))


def test_layer_of_somebody_else_is_never_overwritten(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    theirs = viewer.add_image(np.zeros((5, 5)), name="leaf blur (px)")
    add_results(viewer, results_of(plane))
    assert theirs.data.shape == (5, 5)
    assert len(viewer.layers) == 4


def test_somebody_elses_layer_leads_to_one_new_layer_and_not_to_one_a_run(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    viewer.add_image(np.zeros((5, 5)), name="leaf blur (px)")
    first, second = (add_results(viewer, results_of(plane)) for _ in range(2))
    assert first == second
    assert first[0].name == "leaf blur (px) 2"


def names(viewer):
    return [layer.name for layer in viewer.layers]


def test_earlier_results_stay_beside_the_new_ones_if_that_is_wanted(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    for radius in (1, 2, 3):
        add_results(viewer, results_of(plane, radius=radius), keep_earlier=True)
    assert names(viewer) == [
        "leaf",
        *("leaf blur (px)", "leaf in focus"),
        *("leaf blur (px) 2", "leaf in focus 2"),
        *("leaf blur (px) 3", "leaf in focus 3"),
    ]
    for name, radius in (("", 1), (" 2", 2), (" 3", 3)):
        assert (viewer.layers[f"leaf blur (px){name}"].data == radius).all()


def test_what_one_run_has_made_has_one_number(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    blur_map, mask = results_of(plane)
    add_results(viewer, [blur_map], keep_earlier=True)
    add_results(viewer, [blur_map, mask], keep_earlier=True)
    assert names(viewer) == ["leaf", "leaf blur (px)", "leaf blur (px) 2", "leaf in focus 2"]


def test_next_run_updates_the_newest_of_several_results(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    old, _ = add_results(viewer, results_of(plane, radius=1))
    new, _ = add_results(viewer, results_of(plane, radius=2), keep_earlier=True)
    viewer.layers.move(viewer.layers.index(new), 0)
    updated, _ = add_results(viewer, results_of(plane, radius=3))
    assert updated is new
    assert (new.name, float(new.data.max())) == ("leaf blur (px) 2", 3)
    assert (old.name, float(old.data.max())) == ("leaf blur (px)", 1)


@pytest.mark.parametrize("renamed", [False, True])
def test_newest_result_is_found_wherever_it_stands_and_whatever_its_name(viewer, texture, renamed):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    add_results(viewer, results_of(plane))
    new, _ = add_results(viewer, results_of(plane), keep_earlier=True)
    viewer.layers.move(viewer.layers.index(new), 0)
    if renamed:
        new.name = "the best one"
    assert layer_of_result(viewer.layers, BLUR_MAP, "leaf") is new


def test_duplicate_of_a_result_is_not_taken_for_a_newer_one(viewer, texture):
    plane = plane_of(viewer.add_image(texture, name="leaf"), viewer)
    blur_map, _ = add_results(viewer, results_of(plane))
    data, keywords, kind = blur_map.as_layer_data_tuple()
    viewer.add_layer(Image.create(data, {**keywords, "name": "leaf blur (px) copy"}, kind))
    assert layer_of_result(viewer.layers, BLUR_MAP, "leaf") is blur_map


@pytest.mark.parametrize(
    ("order", "rotate"),
    [((0, 1, 2), 30), ((0, 2, 1), 30), ((1, 0, 2), 0), ((2, 0, 1), 0)],
)
def test_of_a_stack_the_plane_that_is_shown(viewer, order, rotate):
    stack = np.random.default_rng(0).random((7, 32, 48))
    layer = viewer.add_image(
        stack, scale=(5, 0.5, 0.25), translate=(10, 1, 2), rotate=(0, 0, rotate), name="stack"
    )
    sliced = order[0]
    viewer.dims.order = order
    viewer.dims.set_point(sliced, layer.data_to_world((3, 3, 3))[sliced])
    plane = plane_of(layer, viewer)
    np.testing.assert_array_equal(plane.read(), stack.take(3, axis=sliced))
    for result in add_results(viewer, results_of(plane)):
        assert result.data.shape == tuple(np.where(np.arange(3) == sliced, 1, stack.shape))
        for corner in np.ndindex(2, 2, 2):
            on_stack = np.where(np.arange(3) == sliced, 3 + np.array(corner), corner)
            np.testing.assert_allclose(result.data_to_world(corner), layer.data_to_world(on_stack))


def test_next_plane_of_a_stack_moves_the_results(viewer):
    layer = viewer.add_image(np.random.default_rng(0).random((7, 32, 48)), scale=(5, 1, 1))
    viewer.dims.set_current_step(0, 2)
    add_results(viewer, results_of(plane_of(layer, viewer)))
    viewer.dims.set_current_step(0, 6)
    blur_map, _ = add_results(viewer, results_of(plane_of(layer, viewer)))
    assert len(viewer.layers) == 3
    assert blur_map.translate[0] == 30


def test_plane_follows_the_slider_of_the_world_not_of_the_layer(viewer):
    viewer.add_image(np.zeros((20, 32, 48)), name="long")
    short = viewer.add_image(
        np.arange(5.0)[:, None, None] * np.ones((32, 48)), translate=(10, 0, 0)
    )
    viewer.dims.set_current_step(0, 12)
    assert (plane_of(short, viewer).read() == 2).all()
    viewer.dims.set_current_step(0, 3)
    with pytest.raises(NotAnalysableError, match="no plane"):
        plane_of(short, viewer)


def test_stack_shown_as_a_volume_is_refused_but_a_picture_is_not(viewer, texture):
    stack = viewer.add_image(np.zeros((5, 32, 48)))
    picture = viewer.add_image(texture)
    viewer.dims.ndisplay = 3
    with pytest.raises(NotAnalysableError, match="volume"):
        plane_of(stack, viewer)
    assert plane_of(picture, viewer).read().shape == texture.shape


def test_rgb_stack_gives_colour_planes(viewer):
    stack = np.random.default_rng(0).integers(0, 255, (4, 32, 48, 3), np.uint8)
    layer = viewer.add_image(stack)
    viewer.dims.set_current_step(0, 1)
    plane = plane_of(layer, viewer)
    np.testing.assert_array_equal(plane.read(), stack[1])
    [blur_map, _] = add_results(viewer, results_of(plane))
    assert blur_map.data.shape == (1, 32, 48)


def test_of_several_scales_the_finest(viewer):
    fine = np.random.default_rng(0).random((64, 96))
    layer = viewer.add_image([fine, fine[::2, ::2]], scale=(0.5, 0.5))
    plane = plane_of(layer, viewer)
    np.testing.assert_array_equal(plane.read(), fine)
    blur_map, _ = add_results(viewer, results_of(plane))
    assert blur_map.data.shape == fine.shape
    np.testing.assert_allclose(blur_map.extent.world, layer.extent.world)


def test_of_a_dask_stack_only_the_shown_plane_is_computed(viewer):
    computed = []

    def plane(block_info):
        computed.append(block_info[None]["chunk-location"][0])
        return np.full((1, 32, 48), computed[-1], np.uint16)

    stack = da.map_blocks(plane, chunks=((1,) * 9, (32,), (48,)), dtype=np.uint16)
    layer = viewer.add_image(stack, contrast_limits=(0, 10))
    viewer.dims.set_current_step(0, 6)
    lazy = plane_of(layer, viewer)
    computed.clear()
    assert (lazy.read() == 6).all()
    assert set(computed) <= {6}


def test_reading_does_not_hold_on_to_the_users_array(viewer, texture):
    layer = viewer.add_image(texture)
    image = plane_of(layer, viewer).read()
    layer.data[:] = 0
    assert image.max() > 0


def test_infinite_pixels_are_refused_in_plain_words_and_nan_is_read(viewer, texture):
    texture[3, 4] = np.nan
    assert np.isnan(plane_of(viewer.add_image(texture), viewer).read()[3, 4])
    texture[3, 4] = np.inf
    with pytest.raises(NotAnalysableError, match="it has infinite pixels"):
        plane_of(viewer.add_image(texture), viewer).read()


@pytest.mark.parametrize(("name", "refused"), [("print.JPG", True), ("cut-out.png", False)])
def test_inks_are_not_taken_for_colors_and_opacity(viewer, name, refused):
    with layer_source(path=name):
        layer = viewer.add_image(np.full((60, 70, 4), 9, np.uint8), rgb=True)
    if refused:
        with pytest.raises(NotAnalysableError, match=r"JPEG of inks \(CMYK\)"):
            plane_of(layer, viewer).read()
    else:
        assert plane_of(layer, viewer).read().shape == (60, 70, 4)


def test_too_large_a_plane_is_refused_before_it_is_computed(viewer, monkeypatch):
    monkeypatch.setattr(layers, "MAX_PIXELS", 1_000_000)
    plane = plane_of(viewer.add_image(da.zeros((2000, 1000), dtype=np.uint8)), viewer)
    with pytest.raises(NotAnalysableError, match="2 million pixels, more than 1 million"):
        plane.read()


def test_results_follow_a_picture_that_has_become_a_stack(viewer, texture):
    picture = viewer.add_image(texture, name="leaf")
    add_results(viewer, results_of(plane_of(picture, viewer)))
    viewer.layers.remove(picture)
    stack = viewer.add_image(np.stack([texture] * 4), name="leaf", scale=(5, 2, 2))
    viewer.dims.set_current_step(0, 3)
    blur_map, mask = add_results(viewer, results_of(plane_of(stack, viewer)))
    assert len(viewer.layers) == 3
    for layer in (blur_map, mask):
        assert layer.data.shape == (1, *texture.shape)
        np.testing.assert_allclose(layer.data_to_world((0, 0, 0)), (15, 0, 0))


@pytest.mark.parametrize("scales", [1, 2])
def test_plane_is_current_until_its_layer_goes_or_gets_other_data(viewer, texture, scales):
    levels = [texture[::step, ::step] for step in (1, 2)][:scales]
    layer = viewer.add_image(levels if scales > 1 else texture, multiscale=scales > 1)
    plane = plane_of(layer, viewer)
    assert plane.is_current(viewer.layers)
    layer.data = [level.copy() for level in levels] if scales > 1 else texture.copy()
    assert not plane.is_current(viewer.layers)
    plane = plane_of(layer, viewer)
    viewer.layers.remove(layer)
    assert not plane.is_current(viewer.layers)


def test_results_of_a_part_of_a_plane_lie_where_the_part_does(viewer, texture):
    picture = viewer.add_image(texture, name="leaf", **PLACED)
    part = plane_of(picture, viewer).part(slice(10, 40), slice(20, 80))
    assert part.is_part
    assert (part.shape, part.whole_shape) == ((30, 60), texture.shape)
    np.testing.assert_array_equal(part.read(), texture[10:40, 20:80])
    for layer in add_results(viewer, results_of(part)):
        assert layer.data.shape == (30, 60)
        np.testing.assert_allclose(layer.data_to_world((0, 0)), picture.data_to_world((10, 20)))
        np.testing.assert_allclose(layer.data_to_world((29, 59)), picture.data_to_world((39, 79)))
        region = layer.metadata[METADATA_KEY]["region"]
        assert (region["rows"], region["columns"]) == ([10, 40], [20, 80])


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 0, 1)])
def test_part_of_a_plane_of_a_stack_keeps_its_place_when_the_plane_moves(viewer, order):
    stack = np.random.default_rng(0).random((20, 32, 48))
    rotate = 30 if order[0] == 0 else 0
    layer = viewer.add_image(
        stack, scale=(5, 0.5, 0.25), translate=(10, 1, 2), rotate=(0, 0, rotate)
    )
    viewer.dims.order = order
    index = [slice(None)] * 3
    index[order[0]] = 3
    part = layers.plane_at(layer, tuple(index)).part(slice(4, 14), slice(8, 18))
    moved = tuple(7 if isinstance(at, int) else at for at in part.index)
    [blur_map, _] = results_of(part.at(moved))
    [layer_of_map] = add_results(viewer, [blur_map])
    np.testing.assert_array_equal(part.at(moved).read(), stack[moved])
    assert layer_of_map.data.ndim == 3
    np.testing.assert_allclose(
        layer_of_map.data_to_world((0, 0, 0)), layer.data_to_world(layers.corner(moved))
    )
    assert part.at(moved) != part
    assert part.at(moved).at(part.index) == part


def test_parts_are_the_same_plane_only_with_the_same_pixels_that_count(viewer, texture):
    plane = plane_of(viewer.add_image(texture), viewer)
    inside = np.eye(30, dtype=bool)
    parts = [
        plane,
        plane.part(slice(0, 30), slice(0, 30)),
        plane.part(slice(1, 31), slice(0, 30)),
        plane.part(slice(0, 30), slice(0, 30), inside=inside),
        plane.part(slice(0, 30), slice(0, 30), inside=~inside),
    ]
    assert [[a == b for b in parts] for a in parts] == np.eye(5, dtype=bool).tolist()
    assert parts[3] == plane.part(slice(0, 30), slice(0, 30), inside=inside.copy())


def test_part_of_a_plane_that_is_too_large_is_analysed_and_only_it_is_computed(viewer, monkeypatch):
    monkeypatch.setattr(layers, "MAX_PIXELS", 1_000_000)
    computed = []

    def chunk(block_info):
        computed.append(tuple(block_info[None]["chunk-location"]))
        return np.ones((100, 100), np.uint8)

    lazy = da.map_blocks(chunk, chunks=((100,) * 20, (100,) * 10), dtype=np.uint8)
    plane = plane_of(viewer.add_image(lazy, contrast_limits=(0, 1)), viewer)
    computed.clear()
    assert plane.part(slice(310, 390), slice(180, 220)).read().shape == (80, 40)
    assert set(computed) == {(3, 1), (3, 2)}
    with pytest.raises(NotAnalysableError, match="2 million pixels"):
        plane.read()
