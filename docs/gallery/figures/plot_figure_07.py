r"""
Figure 7: from three candidates to a data term
==============================================

How three radii of a window become a cost of each of the 81 labels.

The paper labels the picture with radii from 0 to 8 px in steps of 0.1 px. Three candidates become
a likelihood of labels in three steps: put each candidate's likelihood at its label; widen it by
the kernel :math:`\kappa`; make the sum 1. The cost of a label is
:math:`D(r) = -\log \tilde{p}(r)`.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import estimate_candidates, simulate_defocus
from napari_defocus.labeling.data_term import artificial_likelihood, data_term

halves = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3))
sharp = halves @ [0.299, 0.587, 0.114] / 255
blurred = simulate_defocus(sharp, np.full(sharp.shape, 5.0), noise_variance=1e-7, rng=0)
candidates = estimate_candidates(blurred, noise_variance=1e-7, mode="paper")

# %%
# Take a window whose three candidates are of similar height.

gap = np.ptp(candidates.log_likelihoods, axis=2)
gap[~np.isfinite(gap)] = np.inf
window = np.unravel_index(gap.argmin(), gap.shape)
radii, likelihoods = candidates.radii[window], candidates.log_likelihoods[window]
heights = np.exp(likelihoods - likelihoods.max())

figure, axes = plt.subplots(3, 1, figsize=(6.4, 6.6), sharex=True)
axes[0].stem(radii, heights, basefmt=" ")
axes[0].set(title="candidates, relative to the best", ylabel=r"$\hat{p}_l$")
axes[1].semilogy(candidates.scales, artificial_likelihood(candidates)[window], lw=1.2)
axes[1].set(title=r"widened by $\kappa$, sum 1", ylabel=r"$\tilde{p}(r)$")
axes[2].plot(candidates.scales, data_term(candidates)[window], lw=1.2, label="three candidates")
own = estimate_candidates(blurred, noise_variance=1e-7)
axes[2].plot(own.scales, data_term(own)[window], lw=1.2, label="whole curve, the default")
axes[2].set(title="data term", xlabel="radius $r$ (px)", ylabel="$D(r)$ (nats)", xlim=(0, 8))
axes[2].set_ylim(-3, 80)
axes[2].legend(loc="upper left", ncols=2)
for each in axes:
    each.spines[["top", "right"]].set_visible(False)

# %%
# The paper's data term is deep and narrow: outside the kernel's reach, half a px from a candidate,
# every radius costs the same. The default takes the whole curve instead, limited in depth.
# :doc:`/measured/ablation` says what that gains.
