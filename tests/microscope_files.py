"""Stacks and slides as microscopes and their programs write them, made here."""

import struct

import numpy as np
import tifffile
import zarr

LSM_INFO, UIC1, UIC2 = 34412, 33628, 33629
"""Tags in which LSM and STK say that they are such."""

TILES = {"photometric": "rgb", "tile": (64, 64), "compression": "zlib"}


def write_ome_zarr(path, values, axes, types=None):
    """Write version 0.4, as bioformats2raw does; `types` replaces some of the usual ones."""
    kinds = {"t": "time", "c": "channel"} | (types or {})
    group = zarr.open_group(path, mode="w", zarr_format=2)
    sizes = zip(axes, values.shape, strict=True)
    chunks = tuple(size if axis in "yx" else 1 for axis, size in sizes)
    array = group.create_array("0", shape=values.shape, dtype=values.dtype, chunks=chunks)
    array[:] = values
    declared = [{"name": axis, "type": kinds.get(axis, "space")} for axis in axes]
    scale = {"type": "scale", "scale": [0.5] * len(axes)}
    level = {"path": "0", "coordinateTransformations": [scale]}
    group.attrs["multiscales"] = [{"version": "0.4", "axes": declared, "datasets": [level]}]
    return path


def write_imagej(path, values, axes):
    tifffile.imwrite(path, values, imagej=True, metadata={"axes": axes.upper()})
    return path


def write_ome_tiff(path, values, axes):
    color = {"photometric": "rgb" if axes.endswith("s") else "minisblack"}
    tifffile.imwrite(path, values, ome=True, metadata={"axes": axes.upper()}, **color)
    return path


OBJECTIVE = """<?xml version="1.0" encoding="UTF-8"?>
<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">
<Instrument ID="Instrument:0">
<Objective ID="Objective:0" LensNA="0.8" Immersion="Air"/></Instrument>
<Image ID="Image:0"><ObjectiveSettings ID="Objective:0"/>
<Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="{dtype}" SizeX="{width}" SizeY="{height}"
SizeC="1" SizeZ="1" SizeT="1" PhysicalSizeX="0.1625" PhysicalSizeXUnit="µm" PhysicalSizeY="0.1625"
PhysicalSizeYUnit="µm"><Channel ID="Channel:0:0" EmissionWavelength="520"/>
<TiffData IFD="0" PlaneCount="1"/></Pixels></Image></OME>"""


def write_ome_tiff_of_objective(path, plane):
    """Write a plane that an objective of NA 0.8 in air took at 520 nm, pixels of 0.1625 um."""
    height, width = plane.shape
    text = OBJECTIVE.format(dtype=plane.dtype, height=height, width=width)
    tifffile.imwrite(path, plane, description=text.encode(), metadata=None)
    return path


def write_pages(path, values, axes):
    """Write pages of which the file says nothing."""
    assert len(axes) == 3
    with tifffile.TiffWriter(path) as tiff:
        for plane in values:
            tiff.write(plane, metadata=None, contiguous=False)
    return path


def write_lsm(path, values, axes):
    """Write planes, each with a thumbnail, as a Zeiss LSM does; channels, if any, apart."""
    whole = values if axes == "zcyx" else values[:, None]
    planes, channels, height, width = whole.shape
    info = np.zeros(1, [(name or "reserved", kind) for name, kind in tifffile.TIFF.CZ_LSMINFO])
    sizes = {"DimensionX": width, "DimensionY": height, "DimensionZ": planes}
    steps = {"VoxelSizeX": 1e-7, "VoxelSizeY": 1e-7, "VoxelSizeZ": 5e-7}
    more = {"MagicNumber": 67127628, "StructureSize": info.itemsize, "DimensionTime": 1}
    for name, value in (sizes | steps | more | {"DimensionChannels": channels}).items():
        info[name] = value
    told = info.tobytes()
    apart = {"planarconfig": "separate"} if channels > 1 else {}
    options = {"photometric": "minisblack", "metadata": None, "contiguous": False, **apart}
    with tifffile.TiffWriter(path, byteorder="<") as tiff:
        for number, plane in enumerate(whole):
            tags = [] if number else [(LSM_INFO, 1, len(told), told, True)]
            small = np.zeros_like(plane)
            for picture, more in ((plane, {"extratags": tags}), (small, {"subfiletype": 1})):
                tiff.write(picture if channels > 1 else picture[0], **more, **options)
    return path


def write_stk(path, values, axes):
    """Write one page whose planes lie one behind another, as MetaMorph does."""
    steps = [
        struct.pack("<6I", axes[0] == "z", 1, 2459000, 1000 * at, 2459000, 1000 * at)
        for at in range(len(values))
    ]
    pixels, steps = values.astype("<u2").tobytes(), b"".join(steps)
    planes, height, width = values.shape
    behind = 8 + len(pixels)
    tags = [
        *((254, 4, 1, 0), (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 16)),
        *((259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 8), (277, 3, 1, 1), (278, 4, 1, height)),
        *((279, 4, 1, 2 * height * width), (UIC1, 4, 1, behind + len(steps))),
        (UIC2, 5, planes, behind),
    ]
    header = struct.pack("<2sHI", b"II", 42, behind + len(steps) + 8)
    entries = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    path.write_bytes(header + pixels + steps + bytes(8) + directory)
    return path


def write_slide(path, picture):
    """Write a slide, (H, W, 3), in the format of the name, with what its maker puts beside it."""
    with tifffile.TiffWriter(path, bigtiff=path.suffix in (".scn", ".btf")) as tiff:
        SLIDES[path.suffix](tiff, picture)
    return path


def _write_svs(tiff, picture):
    said = "Aperio Image Library v11.2.1 \r\n"
    whole = f"{said}512x512 [0,0 512x512] (64x64) JPEG/RGB Q=70|AppMag = 20|MPP = 0.4990"
    told = {"metadata": None, **TILES}
    tiff.write(picture, description=whole, **told)
    tiff.write(picture[::2, ::2], photometric="rgb", description=said, metadata=None)
    tiff.write(picture[::4, ::4], description=whole, **told)
    label = {"description": f"{said}label", "subfiletype": 1, "metadata": None}
    tiff.write(picture[:60, :64], photometric="rgb", **label)


def _write_scn(tiff, picture):
    """Two pictures: the overview of the glass comes first."""
    height, width = picture.shape[:2]
    images = "".join(
        f'<image name="{name}"><pixels sizeX="{width}" sizeY="{height}">{dimensions}</pixels>'
        "</image>"
        for name, dimensions in (
            ("macro", '<dimension ifd="0" r="0"/>'),
            ("image 01", '<dimension ifd="1" r="0"/><dimension ifd="2" r="1"/>'),
        )
    )
    schema = "http://www.leica-microsystems.com/scn/2010/10/01"
    xml = f'<?xml version="1.0"?><scn xmlns="{schema}"><collection>{images}</collection></scn>'
    told = {"metadata": None, **TILES}
    tiff.write(picture[::2, ::2], description=xml, **told)
    tiff.write(picture, **told)
    tiff.write(picture[::4, ::4], subfiletype=1, **told)


def _write_qptiff(tiff, picture):
    told = {"metadata": None, "software": "PerkinElmer-QPI", **TILES}
    tiff.write(picture, **told)
    tiff.write(picture[::2, ::2], photometric="rgb", metadata=None)
    tiff.write(picture[::2, ::2], **told)
    for number in (3, 5):
        tiff.write(picture[::number, ::number], photometric="rgb", metadata=None)


def _write_btf(tiff, picture):
    told = {"metadata": None, **TILES}
    tiff.write(picture, subifds=1, **told)
    tiff.write(picture[::2, ::2], subfiletype=1, **told)


SLIDES = {
    ".svs": _write_svs,
    ".scn": _write_scn,
    ".qptiff": _write_qptiff,
    ".btf": _write_btf,
}
