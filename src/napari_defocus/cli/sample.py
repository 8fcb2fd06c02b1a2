"""The terminal commands on photographs of ours: write one, and show what the others do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files as resources
from pathlib import Path
from typing import Any, Literal

from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import (
    lines_of,
    map_facts,
    mask_facts,
    picture_facts,
)
from napari_defocus.cli.results import Files, check_endings, encoded_maps, encoded_masks
from napari_defocus.core.checks import Linearize, check_threshold_or_auto
from napari_defocus.core.progress import Progress, within
from napari_defocus.pipeline import (
    judged_mask,
    label_map,
    measure_candidates,
    segment,
    settled_mask,
    shares,
)
from napari_defocus.settings import MapSettings, MaskSettings

SampleName = Literal["dandelion", "brushes"]

AUTHORS: dict[SampleName, str] = {
    "dandelion": "seeding, by Clements Engelhardt, CC0-1.0",
    "brushes": "Picture 1A, by freespace, CC-BY-4.0",
}


def sample_path(name: SampleName) -> Path:
    """Return where a photograph lies in the package."""
    return Path(str(resources("napari_defocus") / "samples" / f"{name}.jpg"))


def _sample_lines(facts: Facts) -> Iterator[str]:
    yield f"picture      {facts['sample']}: {facts['author']}"
    for path in facts["files"]:
        yield f"wrote        {path}"


@command(
    _sample_lines,
    """
    file FILE
        What to write: a JPEG file.
    name
        Which photograph.
    """,
)
def sample(
    file: Path = Path("photo.jpg"),
    *,
    name: SampleName = "dandelion",
    force: bool = False,
    progress: Progress,
) -> dict[str, Any]:
    """Write a bundled photograph, to try the other commands on."""
    check_endings([file], ".jpg", ".jpeg")
    Files(force=force).write({file: sample_path(name).read_bytes()})
    return {"sample": name, "author": AUTHORS[name], "files": [str(file)]}


def _demo_lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    yield from last_lines(facts)


@command(
    _demo_lines,
    """
    folder FOLDER
        Where to write; made if missing.
    """,
)
def demonstrate(
    folder: Path = Path("demo-output"),
    *,
    psf: str = MapSettings.psf,
    shot_noise: bool = MapSettings.shot_noise,
    linearize: Linearize | None = MapSettings.linearize,
    progress: Progress,
) -> dict[str, Any]:
    """Measure a bundled photograph; all results go into FOLDER.

    Running it again overwrites its results.
    """
    names = ("blur.tif", "blur.png", "confidence.png", "mask.png", "overlay.png")
    outputs = [folder / f"dandelion-{name}" for name in names]
    files = Files(force=True)
    with _folder_for_results(folder):
        settings = MapSettings(psf=psf, shot_noise=shot_noise, linearize=linearize)
        mask_settings = MaskSettings()
        check_threshold_or_auto(mask_settings.threshold, settings.family().max_scale)
        picture = files.read(sample_path("dandelion"), outputs)
        first, second = shares(progress)
        candidates = measure_candidates(picture, settings, None, first)
        found = label_map(candidates, picture, settings, None, within(second, 0.0, 0.5))
        used = settled_mask(candidates, picture, mask_settings)
        mask = segment(candidates, picture, used, progress=within(second, 0.5, 1.0))
        judged = judged_mask(candidates, picture, used, mask=mask)
        contents = encoded_maps(outputs[:2], outputs[2:3], found, settings)
        files.write(contents | encoded_masks(outputs[3:4], outputs[4:], picture, mask))
    facts = picture_facts(Path("dandelion.jpg"), picture, outputs, found, settings)
    return facts | map_facts(found) | mask_facts(mask, judged, mask_settings, used)


@contextmanager
def _folder_for_results(folder: Path) -> Iterator[None]:
    """Make the folder; take it away again if it is new and the work fails."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"cannot write into {folder}: it is not a folder")
    if not folder.absolute().parent.is_dir():
        raise ValueError(f"cannot make {folder}: there is no folder {folder.parent}")
    new = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException:
        if new:
            folder.rmdir()
        raise
