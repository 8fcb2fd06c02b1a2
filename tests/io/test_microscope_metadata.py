"""What files note of their microscope."""

import numpy as np
import pytest
import tifffile
from microscope_files import write_ome_zarr

from napari_defocus import read_microscope
from napari_defocus.io.microscope_metadata import noted_microscope
from napari_defocus.io.open import open_stack

OME = """<?xml version="1.0" encoding="UTF-8"?>
<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">
<Instrument ID="Instrument:0">
<Objective ID="Objective:0" LensNA="0.3" Immersion="Air"/>
<Objective ID="Objective:1" LensNA="1.3" Immersion="Oil"/>
</Instrument>
<Image ID="Image:0"><ObjectiveSettings ID="Objective:1" {settings}/>
<Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="uint16" SizeX="5" SizeY="4" SizeC="2" SizeZ="1"
SizeT="1" PhysicalSizeX="108" PhysicalSizeXUnit="nm" PhysicalSizeY="{height}"
PhysicalSizeYUnit="nm"><Channel ID="Channel:0:0" EmissionWavelength="520"/>
<Channel ID="Channel:0:1" EmissionWavelength="0.61" EmissionWavelengthUnit="µm"/>
<TiffData IFD="0" PlaneCount="2"/></Pixels></Image></OME>"""


@pytest.fixture
def ome_tiff(tmp_path):
    def write(height=108, settings=""):
        path = tmp_path / "cells.ome.tif"
        text = OME.format(height=height, settings=settings).encode()
        tifffile.imwrite(path, np.zeros((2, 4, 5), np.uint16), description=text, metadata=None)
        return path

    return write


def test_all_of_the_microscope_is_read_from_ome_tiff(ome_tiff):
    lens = read_microscope(ome_tiff(), channel=0)
    assert (lens.numerical_aperture, lens.refractive_index) == (1.3, 1.515)
    assert (lens.wavelength_um, lens.pixel_size_um) == pytest.approx((0.52, 0.108))
    assert lens.specimen == "auto"


def test_a_channel_has_its_own_wavelength_and_settings_their_own_index(ome_tiff):
    lens = read_microscope(ome_tiff(settings='RefractiveIndex="1.518"'), channel=1)
    assert (lens.wavelength_um, lens.refractive_index) == pytest.approx((0.61, 1.518))


def test_wavelength_of_one_channel_is_not_taken_for_another(ome_tiff):
    with pytest.raises(ValueError, match=r"channels of .* have different wavelengths"):
        read_microscope(ome_tiff())


def test_what_is_given_counts_more(ome_tiff):
    lens = read_microscope(ome_tiff(), wavelength_um=0.7, specimen="points")
    assert (lens.wavelength_um, lens.specimen, lens.numerical_aperture) == (0.7, "points", 1.3)


def test_ome_xml_beside_a_picture_is_read(tmp_path):
    path = tmp_path / "cells.companion.ome"
    path.write_text(OME.format(height=108, settings=""), "utf-8")
    assert noted_microscope(path)["numerical_aperture"] == 1.3


def test_missing_numbers_are_named(tmp_path):
    path = tmp_path / "plain.tif"
    tifffile.imwrite(path, np.zeros((4, 5), np.uint8))
    with pytest.raises(ValueError, match="does not note the wavelength of emission and the pixel"):
        read_microscope(path, numerical_aperture=0.8, refractive_index=1.0)


def test_pixels_that_are_not_square_are_refused(ome_tiff):
    with pytest.raises(ValueError, match=r"0\.108 x 0\.2 um; it takes square"):
        read_microscope(ome_tiff(height=200))


def test_pixel_size_of_imagej_and_of_ome_zarr_is_read(tmp_path):
    file, store = tmp_path / "stack.tif", tmp_path / "cells.ome.zarr"
    about = {"axes": "YX", "unit": "um"}
    plane = np.zeros((4, 5), np.uint8)
    tifffile.imwrite(file, plane, imagej=True, resolution=(4, 4), metadata=about)
    assert noted_microscope(file)["pixel_size_um"] == pytest.approx(0.25)
    write_ome_zarr(store, np.zeros((4, 5), np.uint16), "yx")
    (store / "OME").mkdir()
    (store / "OME" / "METADATA.ome.xml").write_text(OME.format(height=108, settings=""), "utf-8")
    assert noted_microscope(store)["numerical_aperture"] == 1.3


@pytest.mark.parametrize("size", ["wide", "nan", "inf", "-0.1", ""])
def test_pixel_size_that_is_no_number_is_not_noted(tmp_path, size):
    path = tmp_path / "cells.ome.tif"
    about = {"axes": "YX", "PhysicalSizeX": size, "PhysicalSizeY": "0.1"}
    tifffile.imwrite(path, np.zeros((4, 5), np.uint16), metadata=about)
    noted = noted_microscope(path)["pixel_size_um"]
    assert noted == 0.1, "the other side is readable"
    assert open_stack(path).pixel_size == {"y": 0.1}
