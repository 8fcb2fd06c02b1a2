"""OME-Zarr stores of others are read as they say, and only where they are asked for."""

import json

import numpy as np
import pytest
import zarr
from ome_zarr_models.v04.image import Image as Image04
from ome_zarr_models.v05.image import Image as Image05

from napari_defocus.io.ome_zarr import is_zarr, read_ome_zarr
from napari_defocus.io.pictures import UnreadablePicture

AXES = {
    "t": {"name": "t", "type": "time", "unit": "second"},
    "c": {"name": "c", "type": "channel"},
    "z": {"name": "z", "type": "space", "unit": "micrometer"},
    "y": {"name": "y", "type": "space", "unit": "micrometer"},
    "x": {"name": "x", "type": "space", "unit": "micrometer"},
}
STEPS = {"t": 2.0, "c": 1.0, "z": 1.5, "y": 0.25, "x": 0.5}


def store_of(path, values, axes, *, version="0.5", whole_scale=None, **more):
    """Write a store with plain calls of Zarr, as other programs do."""
    group = zarr.create_group(path, zarr_format=2 if version == "0.4" else 3)
    named = {} if version == "0.4" else {"dimension_names": list(axes)}
    datasets = []
    for level in range(2):
        coarse = values[..., :: level + 1, :: level + 1]
        chunks = (1,) * (values.ndim - 2) + (16, 16)
        group.create_array(str(level), data=coarse, chunks=chunks, **named)
        scale = [STEPS[a] * (level + 1 if a in "yx" else 1) for a in axes]
        transforms = [{"type": "scale", "scale": scale}]
        datasets.append({"path": str(level), "coordinateTransformations": transforms})
    multiscale = {"axes": [AXES[a] for a in axes], "datasets": datasets, "name": "slide"}
    if whole_scale:
        multiscale["coordinateTransformations"] = [{"type": "scale", "scale": whole_scale}]
    about = {"multiscales": [{**multiscale, "version": "0.4"} if version == "0.4" else multiscale]}
    about.update(more)
    group.attrs.update(about if version == "0.4" else {"ome": {"version": "0.5", **about}})
    return path


@pytest.fixture
def planes():
    return np.random.default_rng(3).integers(0, 60000, (2, 3, 40, 50), dtype=np.uint16)


@pytest.mark.parametrize(("version", "model"), [("0.4", Image04), ("0.5", Image05)])
def test_both_versions_are_read_with_scale_and_units(tmp_path, planes, version, model):
    path = store_of(tmp_path / "a.zarr", planes, "tcyx", version=version)
    model.from_zarr(zarr.open_group(path, mode="r"))
    picture = read_ome_zarr(path)
    assert picture.axes == "tcyx"
    np.testing.assert_array_equal(picture.levels[0], planes)
    np.testing.assert_array_equal(picture.levels[1], planes[..., ::2, ::2])
    assert picture.pixel_size == {"t": 2.0, "y": 0.25, "x": 0.5}
    assert picture.units == {"t": "second", "y": "micrometer", "x": "micrometer"}
    assert picture.attributes == {}


def test_scale_of_the_whole_pyramid_counts_too(tmp_path, planes):
    path = store_of(tmp_path / "a.zarr", planes[0], "zyx", whole_scale=[2.0, 4.0, 4.0])
    assert read_ome_zarr(path).pixel_size == {"z": 3.0, "y": 1.0, "x": 2.0}


def test_rows_and_columns_come_last_wherever_they_are_stored(tmp_path, planes):
    picture = read_ome_zarr(store_of(tmp_path / "a.zarr", planes[0], "xyz"))
    assert picture.axes == "zyx"
    np.testing.assert_array_equal(picture.levels[0], planes[0].transpose(2, 1, 0))
    assert picture.pixel_size == {"z": 1.5, "y": 0.25, "x": 0.5}


def test_only_the_chunks_asked_for_are_read(tmp_path, planes):
    path = store_of(tmp_path / "a.zarr", planes, "tcyx")
    for chunk in (path / "0" / "c").rglob("*"):
        if chunk.is_file() and chunk.relative_to(path).parts[2:4] != ("1", "2"):
            chunk.write_bytes(b"no chunk")
    lazy = read_ome_zarr(path).levels[0]
    np.testing.assert_array_equal(lazy[1, 2], planes[1, 2])
    with pytest.raises(UnreadablePicture, match=r"cannot read .*a\.zarr: .*decompress"):
        lazy[0, 0].compute()


def refusal_of(path):
    with pytest.raises(UnreadablePicture) as refused:
        read_ome_zarr(path)
    message = str(refused.value)
    assert message.startswith(f"cannot read {path}: ")
    assert "\n" not in message
    return message


def test_what_is_no_picture_is_refused_with_the_reason(tmp_path, planes):
    assert "no such folder" in refusal_of(tmp_path / "none.zarr")
    (tmp_path / "file.zarr").write_text("text")
    assert "not a folder" in refusal_of(tmp_path / "file.zarr")
    (tmp_path / "empty.zarr").mkdir()
    assert "not an OME-Zarr store" in refusal_of(tmp_path / "empty.zarr")
    zarr.create_group(tmp_path / "bare.zarr")
    assert "no multiscales" in refusal_of(tmp_path / "bare.zarr")
    store = store_of(tmp_path / "a.zarr", planes, "tcyx")
    assert "one level of a picture" in refusal_of(store / "0")
    store_of(tmp_path / "c.zarr", planes.astype(np.complex64), "tcyx")
    assert "complex64; real numbers are read" in refusal_of(tmp_path / "c.zarr")


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_several_pictures_are_refused_with_the_folder_to_give(tmp_path, planes, version):
    about = {"bioformats2raw.layout": 3}
    root = zarr.create_group(tmp_path / "b.zarr", zarr_format=2 if version == "0.4" else 3)
    root.attrs.update(about if version == "0.4" else {"ome": about})
    store_of(tmp_path / "b.zarr" / "0", planes, "tcyx", version=version)
    np.testing.assert_array_equal(read_ome_zarr(tmp_path / "b.zarr").levels[0], planes)
    store_of(tmp_path / "b.zarr" / "1", planes, "tcyx", version=version)
    assert f"2 pictures; give one, such as {tmp_path / 'b.zarr' / '0'}" in refusal_of(
        tmp_path / "b.zarr"
    )
    root.attrs.put({"ome": {"plate": {"wells": [{"path": "B/3"}]}}})
    assert str(tmp_path / "b.zarr" / "B" / "3" / "0") in refusal_of(tmp_path / "b.zarr")


def test_damaged_metadata_are_one_line(tmp_path, planes):
    path = store_of(tmp_path / "a.zarr", planes, "tcyx")
    about = json.loads((path / "zarr.json").read_text())
    del about["attributes"]["ome"]["multiscales"][0]["axes"]
    (path / "zarr.json").write_text(json.dumps(about))
    assert "no axes" in refusal_of(path)
    (path / "zarr.json").write_text("{")
    refusal_of(path)


def test_stores_are_known_by_name_or_content(tmp_path, planes):
    store_of(tmp_path / "slide", planes, "tcyx", version="0.4")
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "photos").mkdir()
    found = [is_zarr(tmp_path / name) for name in ("slide", "a.zarr", "photos", "none.zarr")]
    assert found == [True, True, False, False]
