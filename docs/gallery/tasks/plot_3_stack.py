"""
One sharp picture from a stack
==============================

Put the sharp parts of several planes together, and see which plane was sharp where.

The stack is a circuit board in seven planes through focus, by Petteri Aimonen (MIT licence). In a
terminal, ``napari-defocus sharpest stack.tif`` does the same.
"""

from pathlib import Path

import tifffile
from matplotlib import pyplot as plt

from napari_defocus import sharpest_plane

folder = Path("..", "..", "..", "tests", "stacks")
stack = tifffile.imread(folder / "circuit-board.tif")  # or your own file
print(stack.shape)  # planes, rows, columns

# %%
# No plane is sharp everywhere. The wire at the top is sharp in plane 4, the hole at the bottom in
# plane 3:

_, axes = plt.subplots(1, 3, figsize=(10.0, 2.7))
for each, plane in zip(axes, (2, 3, 4), strict=True):
    each.imshow(stack[plane], cmap="gray")
    each.set_title(f"plane {plane}")
    each.set_axis_off()

# %%
# One call finds for each pixel where between the planes it is sharp, and how sure that is. Notes
# say what was done about planes that moved or flickered.

found = sharpest_plane(stack)
print(*found.notes, sep="\n")

# %%
# The composite is sharp everywhere. The position is the relief of the board, in planes. Where the
# confidence is low there is no texture, and the position comes from around.

_, axes = plt.subplots(1, 3, figsize=(10.0, 2.7))
axes[0].imshow(found.composite, cmap="gray")
axes[0].set_title("composite")
shown = axes[1].imshow(found.position, vmin=0, vmax=6)
axes[1].set_title("position of best focus (planes)")
plt.colorbar(shown, ax=axes[1], shrink=0.8)
shown = axes[2].imshow(found.confidence, vmin=0, vmax=1, cmap="gray")
axes[2].set_title("confidence of the position")
plt.colorbar(shown, ax=axes[2], shrink=0.8)
for each in axes:
    each.set_axis_off()

# %%
# If the planes are a known distance apart, the position times that distance is a height. What is
# known about accuracy, drift and transparent things is in :doc:`/manual/stacks`.
