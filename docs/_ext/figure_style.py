"""How the gallery's figures look, the same for each."""

import matplotlib as mpl


def use(_conf, _script):
    """Set it before every script."""
    mpl.use("agg")
    mpl.rcdefaults()
    mpl.rcParams.update(
        {
            "savefig.dpi": 110,
            "font.size": 9,
            "axes.titlesize": 9,
            "axes.titlelocation": "left",
            "axes.linewidth": 0.6,
            "xtick.major.width": 0.6,
            "ytick.major.width": 0.6,
            "figure.constrained_layout.use": True,
            "image.interpolation": "nearest",
            "legend.frameon": False,
            "legend.fontsize": 8,
        }
    )
