"""
Blurred by more than the largest radius
=======================================

What is blurred by more than the largest radius gets a smaller one, and the confidence does not
notice.

In a picture of 200 x 200 px, radii up to 16 px can be found. Here ``Disc(8.0)`` limits the search
to 8 px. A picture that is blurred by more is not reported as 8 px. A photograph gets a radius near
8 px. A texture that such a blur wipes out can get any radius up to 8 px.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut, gravel

from napari_defocus import Disc, estimate_blur_map, simulate_defocus

portrait = astronaut()[:400, 40:440].reshape(200, 2, 200, 2, 3).mean(axis=(1, 3)) / 255
stones = gravel()[:400, :400].reshape(200, 2, 200, 2).mean(axis=(1, 3)) / 255
radii = np.arange(2, 17, 2)


def measured(sharp, radius):
    """Return percentiles of the map of a uniform blur, and its mean confidence."""
    truth = np.full((200, 200), float(radius))
    seen = simulate_defocus(sharp, truth, psf=Disc(16.0), noise_variance=1e-5, rng=0)
    blur_map, confidence = estimate_blur_map(seen, psf=Disc(8.0), return_confidence=True)
    return [*np.percentile(blur_map, [5, 50, 95]), confidence.mean()]


figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.4))
for shift, (name, sharp) in enumerate({"portrait": portrait, "gravel": stones}.items()):
    low, middle, high, sure = np.array([measured(sharp, radius) for radius in radii]).T
    places = radii + 0.2 * shift
    axes[0].errorbar(places, middle, [middle - low, high - middle], fmt="o", ms=4, label=name)
    axes[1].plot(radii, sure, "o-", ms=4, label=name)
axes[0].plot(radii, radii, "k", lw=0.8, label="truth")
axes[0].axvline(8, color="0.7", lw=0.8)
axes[0].set(xlabel="true radius (px)", ylabel="radius found (px), 5 to 95 %")
axes[1].set(xlabel="true radius (px)", ylabel="mean confidence", ylim=(0, 1))
axes[0].legend()

# %%
# The confidence is a probability under the model, and the largest radius is a part of the model. If
# you leave the largest radius as it is, this happens to small pictures only:
# :ref:`sphx_glr_examples_parameters_plot_3_lens.py`.
