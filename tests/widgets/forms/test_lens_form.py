from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from napari.layers import Image

from napari_defocus import psf_from_text
from napari_defocus.psf import MICROSCOPE
from napari_defocus.widgets.forms import microscope_fields
from napari_defocus.widgets.forms.lens_form import LENSES, MEASURED, LensForm
from napari_defocus.widgets.forms.microscope_fields import noted_in_layer

pytestmark = pytest.mark.display


@pytest.fixture
def form(qapp):
    return LensForm(lambda: "")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("disc", "disc"),
        ("auto", "auto"),
        ("polygon:5:-30", "polygon:5:-30"),
        ("polygon:7", "polygon:7:0"),
        ("annulus:0.35", "annulus:0.35"),
        ("annulus", "annulus:0.5"),
        ("microscope:1.3:0.52:0.1:1.515", "microscope:1.3:0.52:0.1:1.515"),
        ("microscope:0.8:0.52:0.1625:1:points", "microscope:0.8:0.52:0.1625:1:points"),
        ("gaussian", "gaussian"),
        ("generalized-gaussian:1.5", "generalized-gaussian:1.5"),
        ("/lenses/mine.npz", "/lenses/mine.npz"),
    ],
)
def test_what_is_taken_is_told(form, text, told):
    form.take("polygon:9:15")
    form.take("annulus:0.9")
    form.take(text)
    assert form.text() == told


@pytest.mark.parametrize("name", sorted(set(LENSES) - {MEASURED, MICROSCOPE}))
def test_every_lens_starts_with_the_defaults_of_its_family(form, name):
    form.lens.value = name
    assert psf_from_text(form.text()) == psf_from_text(name)


def test_lens_that_was_measured_last_is_filled_in(qapp):
    form = LensForm(lambda: "/lenses/last.npz")
    assert form.text() == "disc"
    form.lens.value = MEASURED
    assert form.text() == "/lenses/last.npz"


def test_measured_lens_needs_a_file(form):
    form.lens.value = MEASURED
    with pytest.raises(ValueError, match="Choose the file"):
        form.text()


def test_pixels_of_a_layer_may_be_wider_than_those_of_microscopes(form):
    form.microscope.take("microscope:0.1:0.52:250:1")
    assert form.microscope.pixel_size.value == 250


@pytest.mark.parametrize(("width", "noted"), [(0.1, 0.1), (0.2, None)])
def test_pixel_size_of_a_layer_is_taken_only_if_pixels_are_square(form, width, noted):
    layer = Image(np.zeros((8, 8)), scale=(0.1, width), units=("um", "um"))
    if noted is None:
        with pytest.raises(ValueError, match=r"0\.1 x 0\.2 um; it takes square ones"):
            noted_in_layer(layer)
    else:
        assert noted_in_layer(layer) == {"pixel_size_um": noted}


@pytest.mark.parametrize(("waves", "taken"), [((461, 509), 0.0), ((509, 509), 0.509)])
def test_of_channels_with_several_wavelengths_none_is_taken_and_it_is_said(
    form, tmp_path, monkeypatch, waves, taken
):
    about = {"PhysicalSizeX": 0.1, "PhysicalSizeY": 0.1, "Channel": {"EmissionWavelength": waves}}
    path = tmp_path / "cells.ome.tif"
    tifffile.imwrite(path, np.zeros((2, 8, 8), np.uint16), metadata={"axes": "CYX", **about})
    layer = Image(np.zeros((2, 8, 8)), name="cells")
    layer._source = layer.source.model_copy(update={"path": str(path)})
    said = []
    monkeypatch.setattr(microscope_fields, "show_info", said.append)
    form.microscope.attach(SimpleNamespace(value=layer))
    form.microscope.read_button.native.click()
    assert form.microscope.wavelength.value == taken
    assert form.microscope.pixel_size.value == 0.1
    assert ("different wavelengths: fill in that of the channel" in said[0]) == (not taken)
