"""
Which of my fields are out of focus?
====================================

Measure a folder of micrographs, and sort out the blurred ones by a report.

The fields are parts of a stained tissue section, *Immunohistochemistry* of scikit-image (no known
copyright restrictions). Two of them get a defocus that we know, and one shows empty glass.
"""

import csv
from pathlib import Path
from tempfile import mkdtemp

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt
from skimage.data import immunohistochemistry

from napari_defocus import FieldLimits, measure_batch, simulate_defocus, write_report

tissue = immunohistochemistry()
folder = Path(mkdtemp(), "fields")
folder.mkdir()
parts = {"A1": (0, 0), "A2": (0, 256), "B1": (256, 0), "B2": (256, 256)}
defocus = {"A2": 2.5, "B1": 5.0}  # px
for name, (row, column) in parts.items():
    field = tissue[row : row + 256, column : column + 256] / 255
    if name in defocus:
        field = simulate_defocus(field, np.full((256, 256), defocus[name]))
    imageio.imwrite(folder / f"{name}.png", np.rint(255 * field.clip(0, 1)).astype(np.uint8))
glass = np.random.default_rng(0).normal(0.9, 0.01, (256, 256, 3))
imageio.imwrite(folder / "B3.png", np.rint(255 * glass).astype(np.uint8))

# %%
# One call measures them all. In a terminal it is ``napari-defocus batch fields -o measured``.

report = measure_batch(folder, folder.parent / "measured")
print(f"{report.flagged} of {report.planes} fields are flagged; look at {report.report.name}")

# %%
# ``report.html`` opens in any browser: fields are sorted worst first, with thumbnails, and these
# names say wells, so there is a plate. The table beside it has the same numbers and flags.
#
# Two of them decide. ``share_sure`` says on how much of the field the map is probably right: if
# that is little, there is nothing to see, and the field is neither sharp nor blurred.
# ``median_known_radius_px`` says how blurred it is where it is known.


def rows_of(table):
    """Return the rows of a table."""
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


rows = rows_of(report.table)
for row in rows:
    radius, sure = row["median_known_radius_px"] or "-", float(row["share_sure"])
    print(f"{row['well']}  {radius:>5} px  {sure:5.0%}  {row['flags'] or 'no flag'}")

# %%
# The same under the pictures:

_, axes = plt.subplots(1, 5, figsize=(10.0, 2.5))
for each, row in zip(axes, rows, strict=True):
    each.imshow(imageio.imread(row["source"]))
    each.set_title(f"{row['well']}: {row['flags'] or 'no flag'}")
    each.set_axis_off()

# %%
# How much blur you accept is up to you. Other limits need no other measurement; in a terminal it
# is ``napari-defocus report measured --in-focus-up-to 3``.

again = write_report(folder.parent / "measured", limits=FieldLimits(in_focus_up_to=3.0))
for row in rows_of(again.table):
    print(f"{row['well']}  {row['flags'] or 'no flag'}")

# %%
# Before you discard fields by such a rule, look at some that it calls blurred, and some that it
# does not. If your microscope makes no discs, choose its lens first:
# :ref:`sphx_glr_examples_tasks_plot_5_lens.py`.
