"""Pages that an earlier build made, of scripts and names that there are no more, are removed."""

from pathlib import Path

import napari_defocus


def remove(app):
    """Look before anything is generated; what is still wanted stays, and is not made again."""
    folder = Path(app.srcdir)
    for page in folder.glob("examples/*/plot_*"):
        script = page.name.split(".")[0] + ".py"
        if not (folder / "gallery" / page.parent.name / script).exists():
            page.unlink()
    for page in folder.glob("api/generated/napari_defocus.*.rst"):
        if page.stem.removeprefix("napari_defocus.") not in napari_defocus.__all__:
            page.unlink()


def setup(app):
    """Come first."""
    app.connect("builder-inited", remove, priority=1)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
