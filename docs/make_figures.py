"""Write the figures of the paper that README.md shows: those of the gallery, as files.

``python docs/make_figures.py [folder]`` runs the scripts in docs/gallery/figures and writes
figure-3.png to figure-6.png and figure-8.png, into docs/images unless told otherwise.
"""

import runpy
import sys
from pathlib import Path

from matplotlib import pyplot as plt

FOLDER = Path(__file__).parent
FIGURES_OF = {
    "plot_figure_03_04": ("figure-3", "figure-4"),
    "plot_figure_05_06": ("figure-5", "figure-6"),
    "plot_figure_08": ("figure-8",),
}


def main(folder: Path) -> None:
    """Run the scripts, and save what they drew."""
    sys.path.insert(0, str(FOLDER / "_ext"))
    from figure_style import use

    folder.mkdir(parents=True, exist_ok=True)
    for script, names in FIGURES_OF.items():
        use({}, script)
        runpy.run_path(str(FOLDER / "gallery" / "figures" / f"{script}.py"))
        for number, name in zip(plt.get_fignums(), names, strict=True):
            path = folder / f"{name}.png"
            plt.figure(number).savefig(path, dpi=140, pil_kwargs={"optimize": True})
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
        plt.close("all")


if __name__ == "__main__":
    if len(sys.argv) > 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]) if len(sys.argv) == 2 else FOLDER / "images")
