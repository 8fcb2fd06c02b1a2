"""What a worker of a batch does: opens a source, measures a plane, makes a source's results whole.

A task says in its own result that it failed: what is wrong with one picture stops no other.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

import napari_defocus
from napari_defocus.batch.folder import Facts, read_note, write_note
from napari_defocus.batch.masks_beside import MaskSource
from napari_defocus.batch.picture_signs import signs_of_picture
from napari_defocus.batch.table import (
    DONE,
    FAILED,
    LEFT,
    PixelCounts,
    Row,
    count_pixels,
    defocus_facts,
)
from napari_defocus.batch.thumbnails import small_pictures
from napari_defocus.core.intensity import Limits
from napari_defocus.core.progress import silent
from napari_defocus.core.writing import write_results
from napari_defocus.io.encoders import (
    blur_map_tiff,
    confidence_tiff,
    mask_png,
    picture_png,
    said_of_map,
    with_opacity,
)
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter, Region, aside
from napari_defocus.io.open import Source, open_source
from napari_defocus.io.provenance import ALL_IN_FOCUS, signature
from napari_defocus.io.settings_file import Settings
from napari_defocus.labeling.focus_threshold import threshold_in_px
from napari_defocus.labeling.known import mask_remarks
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.pipeline import (
    Measurement,
    lens_of_planes,
    measure_map,
    restore,
    segment,
    settled_mask,
    threshold_of_stack,
    used,
)
from napari_defocus.psf import AUTO
from napari_defocus.restoration.all_in_focus import Restoration, RestorationFit
from napari_defocus.settings import BLOCK_SIZE, CONFIDENT, UNKNOWN, MapSettings, MaskSettings

if TYPE_CHECKING:
    import dask.array as da

    from napari_defocus.psf.families import PSFFamily

Index = tuple[int, ...]


@dataclass(frozen=True)
class Kind:
    """A kind of result: how its files are named, and what they say of themselves."""

    ending: str
    suffix: str
    quantity: str
    unit: str
    dtype: Literal["float32", "uint8"]


KINDS = {
    "map": Kind("-blur", ".tif", "defocus blur", "px", "float32"),
    "confidence": Kind("-confidence", ".tif", "confidence of the blur map", "1", "float32"),
    "mask": Kind("-mask", ".png", "in-focus mask", "1", "uint8"),
    "in_focus": Kind("-in-focus", ".png", ALL_IN_FOCUS, "1", "float32"),
}
"""The kinds of results, by the names of the table's columns."""


@dataclass(frozen=True, kw_only=True)
class BatchPlan:
    """What is made of every plane: `kinds` of `KINDS`, "map" among them.

    Below `min_confidence`, the map is NaN. Large planes have parts of `block_size` px a side.
    `within` is where the masks are, if only what they mark counts.
    """

    settings: Settings
    kinds: tuple[str, ...]
    min_confidence: float
    intensity_range: tuple[float, float] | None
    block_size: int = BLOCK_SIZE
    within: str | None = None
    thumbnails: bool = False

    def restoration(self, psf: PSFFamily, noise_variance: float | None) -> Restoration:
        """Return how planes with a family's blur are restored."""
        linearize, tv_weight = self.settings.map.linearize, self.settings.restoration.tv_weight
        return Restoration(psf, noise_variance, tv_weight, linearize, self.intensity_range)

    def counts(
        self,
        blur_map: NDArray[Any],
        confidence: NDArray[Any],
        mask: NDArray[Any] | None,
        threshold: float,
        within: NDArray[Any] | None = None,
    ) -> PixelCounts:
        """Return what the table needs of a plane, or of a part of it."""
        return count_pixels(
            blur_map,
            confidence,
            mask,
            threshold=threshold,
            max_scale=self.settings.map.family().max_scale,
            within=within,
        )

    def facts(self) -> Facts:
        """Return what shapes the results, as JSON holds it."""
        settings = asdict(self.settings)
        shaping = {"map": "map", "mask": "mask", "in_focus": "restoration"}
        parts = {shaping[kind]: settings[shaping[kind]] for kind in self.kinds if kind in shaping}
        # Without masks, the table still says what is in focus.
        parts.setdefault("mask", {"threshold": self.settings.mask.threshold})
        return {
            "version": napari_defocus.__version__,
            "what is made": ", ".join(self.kinds),
            "scale": self.settings.map.family().scale_name,
            **parts,
            "min_confidence": self.min_confidence,
            "intensity_range": self.intensity_range and list(self.intensity_range),
            "block_size": self.block_size,
            "within": self.within,
        }

    def description(self, kind: str) -> Facts:
        """Return what a store of a kind says of itself."""
        about: Facts = {"quantity": KINDS[kind].quantity, "unit": KINDS[kind].unit}
        if kind == "map":
            about = said_of_map(self.settings.map.family().scale_name)
        facts = self.facts()
        shaping = facts["map"] | {"min_confidence": self.min_confidence}
        if kind in ("mask", "in_focus"):
            shaping |= facts["mask" if kind == "mask" else "restoration"]
            shaping["noise_variance"] = facts["map"]["noise_variance"]
        shaping |= {name: facts[name] for name in ("intensity_range", "block_size")}
        return about | signature() | {"settings": shaping}


@dataclass(frozen=True)
class Target:
    """Where a result goes: `path`, when it is whole.

    `store` is what planes are written into, one after another: `path` itself, or a store that
    becomes the file at `path` at the end; None if a plane is a file. `writer` writes it, unless
    it is whole already.
    """

    kind: str
    path: Path
    store: Path | None = None
    writer: OmeZarrWriter | None = None

    def has(self, region: Region) -> bool:
        """Return whether the result of a plane, or of a part of it, is there."""
        if self.store is None:
            return self.path.exists()
        # Without a writer, the store is whole.
        return self.writer is None or self.writer.has_region((*region, ...))


@dataclass(frozen=True, eq=False)
class PlaneTask:
    """A plane to be measured, (H, W[, 3 or 4]), not yet read.

    `known` is what its row says whether it fails or not, `results` what it says of where results
    are; `stack` is the source if restored planes share a range that is found from all of them,
    `lens_from` if they share a lens that is, `threshold_from` if they share a threshold.
    """

    plane: da.Array
    index: Index
    known: Row
    results: dict[str, str]
    targets: tuple[Target, ...]
    row_path: Path
    plan: BatchPlan
    stack: Path | None = None
    lens_from: Path | None = None
    threshold_from: Path | None = None
    within: MaskSource | None = None
    thumbnail: Path | None = None

    def map_settings(self) -> MapSettings:
        """Return what shapes the map: with the lens of the stack, which one worker chooses."""
        settings = self.plan.settings.map
        if self.lens_from is None:
            return settings
        path = self.row_path.with_name("lens.json")
        noted = read_note(path)
        if noted is None:
            planes = _planes_of(self.lens_from)
            chosen = lens_of_planes(planes, settings, self.plan.intensity_range)
            noted = {"psf": settings.settled(chosen.psf).psf}
            write_note(path, noted)
        return replace(settings, psf=noted["psf"])

    def mask_settings(
        self, picture: NDArray[Any], found: BlurCandidates, within: NDArray[Any] | None = None
    ) -> MaskSettings:
        """Return what shapes the mask: with the threshold of the picture, or of its stack."""
        settings, limits = self.plan.settings.mask, self.plan.intensity_range
        if self.threshold_from is None:
            where = within if within is not None and within.any() else None
            return settled_mask(found, picture, settings, limits, within=where)
        return replace(settings, threshold=self.threshold_of_stack())

    def threshold_of_stack(self) -> float:
        """Return the threshold of the stack, noted by the first worker that needs it."""
        assert self.threshold_from is not None
        path = self.row_path.with_name("threshold.json")
        noted = read_note(path)
        if noted is None:
            planes, limits = _planes_of(self.threshold_from), self.plan.intensity_range
            masks = None if self.within is None else self.within.of_stack(self.threshold_from)
            found = threshold_of_stack(planes, self.map_settings(), limits, masks)
            noted = {"threshold": found}
            write_note(path, noted)
        return float(noted["threshold"])


def _planes_of(path: Path) -> list[Any]:
    source = open_source(path)
    return [source.plane(index) for index in source.planes()]


def look_at(path: Path) -> Source | str:
    """Open a source, or say why it cannot be opened."""
    try:
        return open_source(path)
    except Exception as error:
        return reason(error)


def measure_plane(task: PlaneTask) -> Row:
    """Measure a plane, write its results, note that it is finished, and return its row."""
    try:
        picture = np.asarray(task.plane.compute(scheduler="synchronous"))
        plan = task.plan
        within = None if task.within is None else task.within.plane(picture.shape, task.index)
        found = measure_map(picture, task.map_settings(), plan.intensity_range, silent)
        assert found.candidates is not None
        shaping = task.mask_settings(picture, found.candidates, within)
        made = _made_of(found, picture, task, shaping, within)
        _write(task, made, found, picture, within)
        row = task.known | {"status": DONE} | _facts(found, made.get("mask"), plan, shaping, within)
        if LEFT in made:
            row[LEFT] = float(made[LEFT].mean())
        row |= task.results | signs_of_picture(picture, found, within, row)
        if "mask" in made:
            _remark_on_mask(row, plan, shaping)
        write_note(task.row_path, row)
    except Exception as error:
        return failed(task.known, reason(error))
    return row


def _remark_on_mask(row: Row, plan: BatchPlan, shaping: MaskSettings) -> None:
    """Let the column `careful` say why the mask says less than it seems to."""
    found = threshold_in_px(shaping) if plan.settings.mask.threshold == AUTO else None
    sure = row["share_sure"] or 0.0
    remarks = mask_remarks(
        row["share_in_mask"] if sure else None,
        sure,
        unknown=shaping.unknown,
        threshold_found=found,
    )
    row["careful"] = " ".join(filter(None, [row["careful"], *remarks])) or None


def failed(known: Row, error: str) -> Row:
    """Return the row of a plane that could not be measured."""
    return known | {"status": FAILED, "error": error}


def reason(error: BaseException) -> str:
    """Return in one line what was wrong."""
    if isinstance(error, MemoryError):
        return "there is not enough memory for this picture"
    return " ".join(str(error).split()) or type(error).__name__


def _made_of(
    found: Measurement,
    picture: NDArray[Any],
    task: PlaneTask,
    shaping: MaskSettings,
    within: NDArray[Any] | None,
) -> dict[str, NDArray[Any]]:
    plan = task.plan
    assert found.candidates is not None
    assert found.confidence is not None
    made = {"map": found.trusted(plan.min_confidence), "confidence": found.confidence}
    if "mask" in plan.kinds:
        made["mask"] = _masked(found.candidates, picture, shaping, plan, within)
    if "in_focus" in plan.kinds:
        restored, fit = _restored(found, picture, task)
        made |= {"in_focus": with_opacity(restored, picture), LEFT: fit.left_as_it_was}
    return made


def _masked(
    candidates: BlurCandidates,
    picture: NDArray[Any],
    shaping: MaskSettings,
    plan: BatchPlan,
    within: NDArray[Any] | None,
) -> NDArray[np.uint8]:
    if within is not None and not within.any():
        return np.full(within.shape, UNKNOWN if shaping.unknown == "leave" else 0, np.uint8)
    return segment(candidates, picture, shaping, plan.intensity_range, within=within)


def _restored(
    found: Measurement, picture: NDArray[Any], task: PlaneTask
) -> tuple[NDArray[Any], RestorationFit]:
    """Take away what is safe to take away, as the command for one picture does."""
    plan, settings = task.plan, task.plan.settings.restoration
    noise, limits = settings.noise_variance, None
    if task.stack is not None:
        # In the range of all planes, so that they do not flicker.
        limits = _stack_limits(task)
    elif noise is None:
        noise = found.noise_variance
    safe, how = found.cautious(settings.risk), plan.restoration(found.psf, noise)
    return restore(picture, safe, found.confidence, how, limits=limits)


def _stack_limits(task: PlaneTask) -> Limits:
    """Return the limits of all planes: noted by the first worker that needs them."""
    from napari_defocus.tiled.plane_noise import limits_of_planes

    assert task.stack is not None
    path = task.row_path.with_name("limits.json")
    noted = read_note(path)
    if noted is not None:
        return Limits(**noted)
    found: Limits = limits_of_planes(_planes_of(task.stack)).compute(scheduler="synchronous")
    write_note(path, asdict(found))
    return found


def _facts(
    found: Measurement,
    mask: NDArray[Any] | None,
    plan: BatchPlan,
    shaping: MaskSettings,
    within: NDArray[Any] | None,
) -> Row:
    assert found.confidence is not None
    threshold, noise = threshold_in_px(shaping), found.noise_variance
    counts = plan.counts(found.blur_map, found.confidence, mask, threshold, within)
    facts = counts.facts() | {"noise_variance": None if noise is None else float(noise)}
    facts |= {"threshold_px": threshold} | defocus_facts(facts, found.psf)
    return facts | ({} if found.intensities is None else found.intensities.facts())


def _write(
    task: PlaneTask,
    made: Mapping[str, NDArray[Any]],
    found: Measurement,
    picture: NDArray[Any],
    within: NDArray[Any] | None,
) -> None:
    contents = {}
    for target in task.targets:
        if target.writer is None:
            contents[target.path] = _encoded(target.kind, made, found, picture, task.plan)
        else:
            target.writer.write_region((*task.index, ...), made[target.kind])
    if task.thumbnail is not None:
        known = made["confidence"] >= CONFIDENT
        known &= True if within is None else within
        task.thumbnail.parent.mkdir(parents=True, exist_ok=True)
        limits = task.plan.intensity_range
        contents |= small_pictures(task.thumbnail, picture, found.blur_map, known, limits)
    write_results(contents, force=True)


def _encoded(
    kind: str,
    made: Mapping[str, NDArray[Any]],
    found: Measurement,
    picture: NDArray[Any],
    plan: BatchPlan,
) -> bytes:
    """Return a file of the bytes that the commands for one picture write."""
    made_with = used(found, plan.settings.map)
    if kind == "map":
        made_with |= {"min_confidence": plan.min_confidence}
        return blur_map_tiff(made[kind], made_with, found.psf.scale_name)
    if kind == "confidence":
        return confidence_tiff(made[kind], made_with)
    return mask_png(made[kind]) if kind == "mask" else picture_png(made[kind], picture)


def go_on_from_whole(target: Target) -> None:
    """Copy what an earlier run made whole into the store that comes into being again."""
    writer, store = target.writer, target.store
    if writer is not None and store is not None and store.exists():
        chunks = Path("0", "c")
        shutil.copytree(
            store / chunks,
            writer.part / chunks,
            copy_function=_copy_unless_there,
            dirs_exist_ok=True,
        )


def _copy_unless_there(source: str, target: str) -> None:
    if not Path(target).exists():
        # A chunk's file says that it was written: it appears whole.
        part = Path(f"{target}.partial")
        shutil.copyfile(source, part)
        part.replace(target)


def finish(target: Target) -> str | None:
    """Make a result of a source whole, now that every plane was tried; return why that failed.

    It may have been begun before, and killed anywhere. Planes that could not be measured are
    NaN; in masks, not in focus.
    """
    store, writer = target.store, target.writer
    try:
        if writer is not None and writer.part.exists():
            nothing = np.nan if writer.dtype == "float32" else 0
            for tile in writer.missing():
                shape = [part.stop - part.start for part in tile]
                writer.write_region(tile, np.full(shape, nothing, writer.dtype))
            writer.finish()
        if store is not None:
            # Killed at its very end, an earlier run may have left what it replaced.
            shutil.rmtree(aside(store), ignore_errors=True)
            if store != target.path and store.exists():
                _convert(store, target.path)
    except Exception as error:
        return reason(error)
    return None


def _convert(store: Path, path: Path) -> None:
    """Write a store as a TIFF."""
    from napari_defocus.io.ome_zarr import read_ome_zarr
    from napari_defocus.io.tiff_writer import write_pyramidal_tiff

    attributes, source = read_ome_zarr(store).attributes, open_source(store)
    write_pyramidal_tiff(
        path,
        source.data,
        axes=source.axes,
        pixel_size=source.pixel_size,
        units=source.units,
        description=attributes,
        labels=source.data.dtype == np.uint8,
        force=True,
    )


def discard(target: Target) -> None:
    """Remove what was begun of a result that will not be whole."""
    if target.writer is not None:
        shutil.rmtree(target.writer.part, ignore_errors=True)
