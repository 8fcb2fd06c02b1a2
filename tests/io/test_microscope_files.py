"""CZI, ND2 and LIF: planes, channels, scenes, colours and sizes, whatever program wrote them.

CZI files are written by ZEISS' own library, LIF files byte by byte. No package writes ND2 files, so
a stand-in takes the place of bioio-nd2's reader. It is a subclass of bioio's real base class.
"""

import json
import struct
import sys
from datetime import timedelta
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import assert_fails_in_one_line, run

from napari_defocus.core import extras
from napari_defocus.io.microscope_metadata import noted_microscope
from napari_defocus.io.open import find_sources, open_source, open_stack
from napari_defocus.io.pictures import UnreadablePicture, read_picture

ND2_START = b"\xda\xce\xbe\x0a" + bytes(60)


def values_of(source):
    return source.data.compute(scheduler="synchronous")


# --- CZI ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stack():
    """(channels, planes, rows, columns)"""
    return np.random.default_rng(0).integers(0, 4000, (2, 5, 48, 64)).astype(np.uint16)


@pytest.fixture
def czi_stack(tmp_path, stack):
    pytest.importorskip("bioio_czi")
    writer = pytest.importorskip("pylibCZIrw.czi")
    path = tmp_path / "cells.czi"
    with writer.create_czi(str(path)) as document:
        for channel, plane in np.ndindex(stack.shape[:2]):
            document.write(stack[channel, plane], plane={"C": channel, "Z": plane, "T": 0})
        document.write_metadata(
            "cells",
            channel_names={0: "DAPI", 1: "GFP"},
            scale_x=0.1e-6,
            scale_y=0.1e-6,
            scale_z=0.5e-6,
        )
    return path


def test_czi_stack_keeps_planes_channels_and_sizes(czi_stack, stack):
    source = open_source(czi_stack)
    assert source.axes == "czyx"
    assert source.channel_names == ("DAPI", "GFP")
    assert source.pixel_size == pytest.approx({"z": 0.5, "y": 0.1, "x": 0.1})
    assert set(source.units.values()) == {"micrometer"}
    np.testing.assert_array_equal(values_of(source), stack)
    assert noted_microscope(czi_stack)["pixel_size_um"] == pytest.approx(0.1)


def test_a_plane_of_a_stack_is_a_block_so_that_no_more_is_read(czi_stack):
    assert open_source(czi_stack).data.chunksize == (1, 1, 48, 64)


def test_czi_is_told_by_its_content_and_can_be_sent_to_other_processes(czi_stack, stack):
    import cloudpickle

    renamed = czi_stack.rename(czi_stack.with_name("cells.dat"))
    sent = cloudpickle.dumps(open_source(renamed).plane((1, 3)))
    assert len(sent) < 100_000
    there = cloudpickle.loads(sent)
    np.testing.assert_array_equal(there.compute(scheduler="synchronous"), stack[1, 3])


@pytest.fixture
def czi_mosaic(tmp_path):
    """Six tiles of 64 x 64 px in colour, and what they show: red on the left, blue on the right."""
    pytest.importorskip("bioio_czi")
    writer = pytest.importorskip("pylibCZIrw.czi")
    shown = np.zeros((128, 192, 3), np.uint8)
    shown[..., 0] = np.linspace(200, 0, 192)
    shown[..., 1] = np.random.default_rng(0).integers(0, 100, (128, 192))
    shown[..., 2] = np.linspace(0, 200, 192)
    path = tmp_path / "slide.czi"
    with writer.create_czi(str(path)) as document:
        for row, column in np.ndindex(2, 3):
            tile = shown[64 * row :, 64 * column :][:64, :64, ::-1]  # CZI keeps blue first
            document.write(np.ascontiguousarray(tile), location=(64 * column, 64 * row))
        document.write_metadata("slide", scale_x=0.2e-6, scale_y=0.2e-6)
    return path, shown


def test_tiles_of_a_czi_become_one_picture_with_red_as_red(czi_mosaic):
    path, shown = czi_mosaic
    np.testing.assert_array_equal(read_picture(path), shown)
    source = open_source(path)
    assert source.axes == "yxs"
    assert source.data.chunksize == (64, 64, 3)
    np.testing.assert_array_equal(source.data[50:80, 60:130].compute(), shown[50:80, 60:130])


def test_scenes_that_a_czi_does_not_name_are_not_left_out_in_silence(tmp_path, stack):
    pytest.importorskip("bioio_czi")
    writer = pytest.importorskip("pylibCZIrw.czi")
    path = tmp_path / "two.czi"
    with writer.create_czi(str(path)) as document:
        for scene in range(2):
            document.write(stack[0, scene], location=(300 * scene, 0), scene=scene)
        document.write_metadata("two", scale_x=1e-7, scale_y=1e-7)
    with pytest.raises(UnreadablePicture, match="it has 2 scenes, and notes only 1 of them"):
        open_source(path)


def test_czi_works_in_a_terminal(czi_stack, czi_mosaic, tmp_path):
    path, _ = czi_mosaic
    facts = json.loads(run("map", path, "-o", tmp_path / "map.tif", "--stride", 8, "--json").stdout)
    assert (facts["width"], facts["height"]) == (192, 128)
    told = run("sharpest", czi_stack, "--channel", 1, "-o", tmp_path / "sharp.tif").stdout
    assert "5 planes of 64 x 48 px" in told
    assert "channel      1 (from 0), GFP" in told
    assert_fails_in_one_line(run("map", czi_stack), saying="a stack of 2 x 5 x 48 x 64 (axes CZYX)")


def test_folders_are_searched_for_files_of_microscopes_if_they_can_be_read(czi_stack):
    assert find_sources([czi_stack.parent]) == [czi_stack]


# --- LIF ------------------------------------------------------------------------------------

LIF_DIMENSIONS = {"x": 1, "y": 2, "z": 3, "t": 4}


def lif_scene(name, values, axes, block):
    """Return the XML of an image, as Leica's programs write it: lengths are of all steps, in m."""
    sizes, strides, step = dict(zip(axes, values.shape, strict=True)), {}, values.itemsize
    for axis, size in reversed(sizes.items()):
        strides[axis], step = step, step * size
    channels = [
        f'<ChannelDescription DataType="0" ChannelTag="0" Resolution="16" '
        f'NameOfMeasuredQuantity="" Min="0" Max="65535" Unit="" LUTName="{lut}" IsLUTInverted="0" '
        f'BytesInc="{at * strides.get("c", 0)}" BitInc="0"/>'
        for at, lut in enumerate(["Green", "Red"][: sizes.get("c", 1)])
    ]
    dimensions = [
        f'<DimensionDescription DimID="{LIF_DIMENSIONS[axis]}" NumberOfElements="{sizes[axis]}" '
        f'Origin="0" Length="{(sizes[axis] - 1) * (5e-7 if axis == "z" else 1e-7)}" Unit="m" '
        f'BitInc="0" BytesInc="{strides[axis]}"/>'
        for axis in reversed(axes)
        if axis != "c"
    ]
    return (
        f'<Element Name="{name}" Visibility="1" UniqueID="{block}"><Data><Image>'
        f"<ImageDescription><Channels>{''.join(channels)}</Channels>"
        f"<Dimensions>{''.join(dimensions)}</Dimensions></ImageDescription>"
        '<Attachment Name="HardwareSetting"><ATLConfocalSettingDefinition NumericalAperture="1.4" '
        'RefractionIndex="1.518" Immersion="OIL"/></Attachment></Image></Data>'
        f'<Memory Size="{values.nbytes}" MemoryBlockID="{block}"/><Children/></Element>'
    )


def write_lif(path, scenes):
    """Write a LIF file, version 2, of scenes: (name, values, axes)."""
    blocks = [f"MemBlock_{number}" for number in range(len(scenes))]
    each = (lif_scene(*scene, block) for scene, block in zip(scenes, blocks, strict=True))
    xml = (
        '<LMSDataContainerHeader Version="2"><Element Name="project" Visibility="1"><Data/>'
        f"<Memory Size='0' MemoryBlockID='MemBlock_x'/><Children>{''.join(each)}</Children>"
        "</Element></LMSDataContainerHeader>"
    )
    assert ElementTree.fromstring(xml) is not None
    content = struct.pack("<IIBI", 0x70, 5 + 2 * len(xml), 0x2A, len(xml)) + xml.encode("utf-16-le")
    for (_, values, _), block in zip(scenes, blocks, strict=True):
        about = struct.pack("<BQBI", 0x2A, values.nbytes, 0x2A, len(block))
        about += block.encode("utf-16-le")
        content += struct.pack("<II", 0x70, len(about)) + about + values.tobytes()
    path.write_bytes(content)
    return path


def test_lif_stack_keeps_planes_channels_sizes_and_what_is_noted_of_the_objective(tmp_path, stack):
    pytest.importorskip("bioio_lif")
    path = write_lif(tmp_path / "cells.lif", [("cells", stack, "czyx")])
    source = open_source(path)
    assert source.axes == "czyx"
    assert len(source.channel_names) == 2
    assert source.data.chunksize == (1, 1, 48, 64)
    assert source.pixel_size == pytest.approx({"z": 0.5, "y": 0.1, "x": 0.1})
    np.testing.assert_array_equal(values_of(source), stack)
    assert noted_microscope(path) == pytest.approx(
        {
            "numerical_aperture": 1.4,
            "wavelength_um": None,
            "pixel_size_um": 0.1,
            "refractive_index": 1.518,
        }
    )


def test_scenes_of_one_form_are_planes_and_one_can_be_chosen(tmp_path, stack):
    pytest.importorskip("bioio_lif")
    scenes = [("one", stack[0], "zyx"), ("two", stack[1], "zyx")]
    path = write_lif(tmp_path / "cells.lif", scenes)
    source = open_source(path)
    assert source.axes == "pzyx"
    assert source.label_of((1, 3)) == "p=1 z=3"
    np.testing.assert_array_equal(values_of(source), stack)
    np.testing.assert_array_equal(values_of(open_source(path, scene=1)), stack[1])
    with pytest.raises(UnreadablePicture, match=r"scene is 2; it has scenes 0 to 1"):
        open_source(path, scene=2)
    # Scenes are no planes through focus.
    for command in (["sharpest", path], ["sharpest", path, "--channel", 0]):
        assert_fails_in_one_line(run(*command), saying="it holds 2 scenes; scene chooses one")
    told = run("sharpest", path, "--scene", 1, "-o", tmp_path / "sharp.tif").stdout
    assert "scene        1 (from 0)" in told
    assert open_stack(path, scene=1).axes == "zyx"


def test_scenes_of_different_forms_are_listed(tmp_path, stack):
    pytest.importorskip("bioio_lif")
    scenes = [("stack", stack[0], "zyx"), ("overview", stack[1, 0], "yx")]
    path = write_lif(tmp_path / "cells.lif", scenes)
    with pytest.raises(UnreadablePicture) as refused:
        open_source(path)
    said = str(refused.value)
    assert "2 scenes of different forms" in said
    assert "5 x 48 x 64 (axes zyx)" in said
    assert "48 x 64 (axes yx)" in said
    assert "sharpest --scene 0" in said
    assert open_source(path, scene=1).axes == "yx"


def test_other_files_have_no_scenes(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(3))
    with pytest.raises(ValueError, match=r"scene is 0, but .*a\.npy has none; CZI, ND2 and LIF"):
        open_source(tmp_path / "a.npy", scene=0)


def test_damaged_files_are_refused_in_one_line(tmp_path, stack):
    pytest.importorskip("bioio_lif")
    whole = write_lif(tmp_path / "whole.lif", [("cells", stack, "czyx")]).read_bytes()
    pytest.importorskip("bioio_czi")
    files = [("a.czi", b"ZISRAWFILE" + bytes(200), "CZI"), ("a.lif", whole[:500], "LIF")]
    for name, content, kind in files:
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(UnreadablePicture) as refused:
            open_source(path)
        assert f"{path}: it is a {kind} file of " in str(refused.value)
        assert "which could not be read (" in str(refused.value)
        assert "\n" not in str(refused.value)


# --- ND2, and what no file here can show ------------------------------------------------------


@pytest.fixture
def nd2_file(tmp_path, monkeypatch, stack):
    """A file whose reader is a stand-in: T, C, Z, Y, X, as bioio-nd2 gives them."""
    reader = pytest.importorskip("bioio_base.reader")
    types = pytest.importorskip("bioio_base.types")
    ome = pytest.importorskip("ome_types")
    import dask.array as da
    import xarray as xr

    volume = SimpleNamespace(axesCalibrated=(True, True, True))
    metadata = SimpleNamespace(channels=[SimpleNamespace(volume=volume)])

    class Reader(reader.Reader):
        scenes = ("XYPos:0",)
        physical_pixel_sizes = types.PhysicalPixelSizes(0.3, 0.065, 0.065)
        time_interval = timedelta(seconds=2)
        ome_metadata = ome.from_xml(
            '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
            '<Instrument ID="Instrument:0">'
            '<Objective ID="Objective:0" LensNA="1.49" Immersion="Oil"/></Instrument>'
            '<Image ID="Image:0"><InstrumentRef ID="Instrument:0"/>'
            '<ObjectiveSettings ID="Objective:0" RefractiveIndex="1.515"/>'
            '<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="64" SizeY="48" '
            'SizeZ="5" SizeC="2" SizeT="1"><Channel ID="Channel:0:0" EmissionWavelength="461"/>'
            '<Channel ID="Channel:0:1" EmissionWavelength="520"/></Pixels></Image></OME>'
        )

        def __init__(self, image):
            self._path = image

        @staticmethod
        def _is_supported_image(fs, path, **options):
            return True

        def _read_delayed(self):
            data = da.from_array(stack[None], chunks=(1, 2, 1, 48, 64))
            noted = {"unprocessed": {"metadata": metadata}}
            names = {"C": ["DAPI", "GFP"]}
            return xr.DataArray(data, dims=list("TCZYX"), coords=names, attrs=noted)

        _read_immediate = _read_delayed

    module = ModuleType("bioio_nd2")
    module.Reader = Reader
    monkeypatch.setitem(sys.modules, "bioio_nd2", module)
    path = tmp_path / "cells.nd2"
    path.write_bytes(ND2_START)
    return SimpleNamespace(path=path, volume=volume)


def test_nd2_stack_keeps_planes_channels_sizes_and_its_microscope(nd2_file, stack):
    source = open_source(nd2_file.path)
    assert source.axes == "czyx"
    assert source.channel_names == ("DAPI", "GFP")
    assert source.pixel_size == pytest.approx({"z": 0.3, "y": 0.065, "x": 0.065})
    np.testing.assert_array_equal(values_of(source), stack)
    assert noted_microscope(nd2_file.path, channel=1) == pytest.approx(
        {
            "numerical_aperture": 1.49,
            "wavelength_um": 0.52,
            "pixel_size_um": 0.065,
            "refractive_index": 1.515,
        }
    )


def test_sizes_that_nikon_made_up_are_not_known(nd2_file):
    """Nikon's programs note 1 um for what was never calibrated."""
    nd2_file.volume.axesCalibrated = (False, False, True)
    assert open_source(nd2_file.path).pixel_size == {"z": 0.3}


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"ZISRAWFILE", "a CZI file of ZEISS"),
        (ND2_START, "an ND2 file of Nikon"),
        (b"\x70\0\0\0", "a LIF file of Leica"),
    ],
)
def test_without_the_extra_the_message_names_it(tmp_path, monkeypatch, start, kind):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(extras, "import_module", missing)
    path = tmp_path / "cells.png"
    path.write_bytes(start + bytes(200))
    for read in (read_picture, open_source):
        with pytest.raises(UnreadablePicture) as refused:
            read(path)
        assert str(refused.value) == (
            f"cannot read {path}: it is {kind}, which needs pip install "
            "'napari-defocus[microscopes]'; or save it as OME-TIFF or OME-Zarr with Fiji or "
            "bioformats2raw first"
        )


def test_without_the_extra_folders_leave_such_files_out(tmp_path, monkeypatch):
    monkeypatch.setattr("napari_defocus.io.picture_files.is_there", lambda package: False)
    Path(tmp_path, "cells.czi").touch()
    with pytest.raises(UnreadablePicture, match=r"has no pictures .*left out: 1 \.czi"):
        find_sources([tmp_path])


def test_layer_of_another_plugin_keeps_its_pixel_size_without_the_extra(tmp_path, monkeypatch):
    """napari opens such files with any plugin that reads them."""
    from napari_defocus.widgets.forms.microscope_fields import noted_in_layer

    monkeypatch.setattr("napari_defocus.io.microscope_files.is_there", lambda package: False)
    path = tmp_path / "cells.czi"
    path.write_bytes(b"ZISRAWFILE" + bytes(200))
    source = SimpleNamespace(path=str(path))
    units = ("micrometer", "micrometer")
    layer = SimpleNamespace(name="cells", source=source, scale=(0.2, 0.2), units=units)
    assert noted_in_layer(layer) == {"pixel_size_um": 0.2}
