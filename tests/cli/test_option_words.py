"""Errors name an option as it is typed, and nothing else."""

import pytest

from napari_defocus.cli.option_words import in_option_words

OPTIONS = ["--focal-length", "--f-number", "--psf", "--intensity-range", "--pixel-pitch"]


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ("psf is 'foo'; it takes disc", "--psf is 'foo'; it takes disc"),
        ("pixel_pitch_um is -5.0", "--pixel-pitch is -5.0"),
        ("it lacks focal_length_mm and f_number", "it lacks --focal-length and --f-number"),
        ("cannot read intensity_range: it is empty", "cannot read intensity_range: it is empty"),
        ("the file my/f_number.tif has no psf", "the file my/f_number.tif has no psf"),
        ("intensity_ranges is 3", "intensity_ranges is 3"),
    ],
)
def test_option_is_named_as_it_is_typed_and_no_file_is_renamed(message, told):
    assert in_option_words(message, OPTIONS) == told
