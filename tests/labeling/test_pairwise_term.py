import numpy as np

from napari_defocus import Disc
from napari_defocus.labeling.pairwise_term import label_positions
from napari_defocus.likelihood.blur_spectra import label_scales
from napari_defocus.likelihood.scale_space import joined_scales


def test_up_to_8_px_labels_are_as_far_apart_as_their_numbers():
    scales = label_scales(Disc(8.0))
    np.testing.assert_allclose(label_positions(scales), np.arange(81), atol=1e-5)


def test_beyond_8_px_an_octave_costs_as_much_as_4_px():
    scales = joined_scales(64.0, 41, 4)
    position = label_positions(scales)
    assert (np.diff(position) > 0).all()
    at = {radius: position[np.argmin(np.abs(scales - radius))] for radius in (8, 16, 32, 64)}
    np.testing.assert_allclose(list(at.values()), [80, 120, 160, 200], atol=1e-4)
