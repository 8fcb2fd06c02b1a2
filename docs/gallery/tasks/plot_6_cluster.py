"""
On a cluster
============

Measure thousands of pictures on many machines, end it at any moment, and go on.

The pictures are the two samples of this package: *seeding*, by Clements Engelhardt (CC0-1.0), and
*Picture 1A*, by freespace (CC-BY-4.0), each cut into four.
"""

import csv
from importlib.resources import files
from pathlib import Path
from tempfile import mkdtemp

import imageio.v3 as imageio
import tifffile
from matplotlib import pyplot as plt

from napari_defocus import measure_batch

folder = Path(mkdtemp(), "pictures")
folder.mkdir()
for name in ("dandelion", "brushes"):
    whole = imageio.imread(files("napari_defocus.samples") / f"{name}.jpg")
    for number in range(4):
        row, column = 250 * (number // 2), 400 * (number % 2)
        part = whole[row : row + 250, column : column + 300]
        imageio.imwrite(folder / f"{name}-{number}.png", part)

# %%
# On one machine
# --------------
#
# Without a client, the work is done in this process. ``dask_client(workers=8)`` starts eight
# processes. In a terminal: ``napari-defocus batch pictures -o measured --workers 8``.

report = measure_batch(folder, folder.parent / "measured", confidence=True)
print(f"{report.planes} measured, {report.failed} failed")

# %%
# Go on after the end of a job
# ----------------------------
#
# The time of a job on a cluster is limited. Start the same command again: what is finished is not
# done again. Here a ninth picture has come in the meantime, and it alone is measured.

imageio.imwrite(folder / "late.png", part[:200, :200])
steps = []
report = measure_batch(
    folder, folder.parent / "measured", confidence=True, progress=lambda step, _: steps.append(step)
)
print(f"{report.planes} in the table, {report.failed} failed; last step: {steps[-1]}")

# %%
# On many machines
# ----------------
#
# Start a dask scheduler and its workers, in the way of your cluster. With Slurm, for instance:
#
# .. code-block:: sh
#
#    dask scheduler --scheduler-file /shared/scheduler.json &
#    srun --ntasks 32 dask worker --nthreads 1 --scheduler-file /shared/scheduler.json &
#    napari-defocus batch /shared/pictures -o /shared/measured --scheduler tcp://10.0.0.5:8786
#
# All workers need the same version of napari-defocus, and see the folders under the same paths. The
# results are the same, byte for byte, on any number of workers.

# %%
# The results
# -----------
#
# ``table.csv`` has a row for each picture, and the maps lie beside it.

with report.table.open(encoding="utf-8") as file:
    rows = list(csv.DictReader(file))
_, grid = plt.subplots(3, 3, figsize=(8.0, 6.6))
for each, row in zip(grid.flat, rows, strict=True):
    each.imshow(tifffile.imread(report.table.parent / row["map"]), vmin=0, vmax=8)
    each.set_title(f"{Path(row['source']).stem}: {float(row['median_radius_px']):.1f} px")
    each.set_axis_off()
