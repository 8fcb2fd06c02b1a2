"""The files that terminal commands write: names, contents, and when they are refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.microscope import microscope_of
from napari_defocus.cli.option_groups import OptionGroup
from napari_defocus.cli.settings_options import saved_settings
from napari_defocus.pipeline import Measurement, used
from napari_defocus.settings import MapSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.restoration.all_in_focus import RestorationFit


@dataclass(frozen=True, kw_only=True)
class Files(OptionGroup):
    """Where settings are read from and written to, and whether files are overwritten."""

    settings_file: Path | None = None
    save_settings: Path | None = None
    force: bool = False

    def read(self, image: Path, outputs: list[Path], *sources: Path | None) -> NDArray[Any]:
        """Return a picture; results that could not be written beside it are refused now.

        Parameters
        ----------
        image : Path
        outputs : list of Path
            What will be written, without the settings' file.
        *sources : Path or None
            What else is read: it is not overwritten either.
        """
        from napari_defocus.core.writing import check_results
        from napari_defocus.io.pictures import read_picture

        picture = read_picture(image)
        results = [*outputs, self.save_settings] if self.save_settings else outputs
        for source in (image, *sources):
            check_results(results, force=self.force, source=source)
        return picture

    def write(self, contents: Mapping[Path, bytes], command: str = "", **parts: Any) -> None:
        """Write the results of a command, and the parts of the settings that it used."""
        from napari_defocus.core.writing import write_results

        settings = {}
        if self.save_settings:
            encoded = saved_settings(command, napari_defocus.Settings(**parts))
            settings = {self.save_settings: encoded}
        write_results({**contents, **settings}, force=self.force)


def beside(image: Path, *endings: str) -> list[Path]:
    """Return the paths of results that are not named."""
    return [image.parent / f"{image.stem}{ending}" for ending in endings]


def check_endings(outputs: list[Path], *endings: str) -> None:
    """Check what the names of results end in."""
    for path in outputs:
        if path.suffix.lower() not in endings:
            raise ValueError(f"cannot write {path}: its name must end in {' or '.join(endings)}")


def encoded(
    outputs: list[Path], png: Callable[[], bytes], tiff: Callable[[], bytes]
) -> dict[Path, bytes]:
    """Return what the files of a result hold, as their names end."""
    return {path: png() if path.suffix.lower() == ".png" else tiff() for path in outputs}


def encoded_maps(
    maps: list[Path],
    confidences: list[Path],
    found: Measurement,
    settings: MapSettings,
    min_confidence: float = 0.0,
) -> dict[Path, bytes]:
    """Return what the files of a map that was measured hold, and those of its confidence."""
    from napari_defocus.io import encoders

    trusted, psf, made_with = found.trusted(min_confidence), found.psf, used(found, settings)
    lens = microscope_of(found)
    um_per_px = None if lens is None else lens.defocus_um(1.0)
    confidence, shaping = found.confidence, made_with | {"min_confidence": min_confidence}
    assert confidence is not None
    return encoded(
        maps,
        lambda: encoders.blur_map_png(trusted, None, psf.scale_name, min_confidence, um_per_px),
        lambda: encoders.blur_map_tiff(trusted, shaping, psf.scale_name),
    ) | encoded(
        confidences,
        lambda: encoders.confidence_png(confidence),
        lambda: encoders.confidence_tiff(confidence, made_with),
    )


def encoded_defocus(
    outputs: list[Path], found: Measurement, settings: MapSettings, min_confidence: float = 0.0
) -> dict[Path, bytes]:
    """Return what the files of the defocus in um hold, of a map that a microscope measured."""
    from napari_defocus.io.encoders import defocus_tiff

    lens = microscope_of(found)
    if lens is None:
        return {}
    made_with = used(found, settings) | {"min_confidence": min_confidence}
    contents = defocus_tiff(lens.defocus_um(found.trusted(min_confidence)), made_with)
    return dict.fromkeys(outputs, contents)


def encoded_left(
    lefts: list[Path], fit: RestorationFit, made_with: Mapping[str, Any]
) -> dict[Path, bytes]:
    """Return what the files hold that say how far a restored picture was left as it was."""
    from napari_defocus.io import encoders

    left = fit.left_as_it_was
    return encoded(
        lefts,
        lambda: encoders.left_as_it_was_png(left),
        lambda: encoders.left_as_it_was_tiff(left, made_with),
    )


def encoded_masks(
    masks: list[Path],
    overlays: list[Path],
    picture: NDArray[Any],
    mask: NDArray[Any],
    intensity_range: tuple[float, float] | None = None,
) -> dict[Path, bytes]:
    """Return what the files of a mask hold, and those that show it on its picture."""
    from napari_defocus.io.encoders import mask_png, overlay_png

    shown = {path: overlay_png(picture, mask, intensity_range) for path in overlays}
    return {path: mask_png(mask) for path in masks} | shown
