"""Options that come together in several terminal commands: a dataclass a group.

A command takes a group as one parameter; `with_options` shows typer an option for each of its
fields. What is new in a group is new in all commands that take it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_type_hints

from napari_defocus.cli.microscope import microscope_text
from napari_defocus.cli.options import SHARED, Entry, entries_in, shown
from napari_defocus.core.checks import Linearize, Mode
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import Measurement, find_blur
from napari_defocus.settings import FieldLimits, MapSettings, RestorationSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray


class OptionGroup:
    """A dataclass whose fields are options, and have defaults."""

    entries: ClassVar[dict[str, Entry]] = {}
    """Help texts that differ from those that commands share."""


@dataclass(frozen=True, kw_only=True)
class EvidenceOptions(OptionGroup):
    """What the evidence of windows is measured with."""

    psf: str = MapSettings.psf
    noise_variance: float | None = MapSettings.noise_variance
    shot_noise: bool = MapSettings.shot_noise
    max_radius: float = MapSettings.max_radius
    window: int = MapSettings.window
    stride: int = MapSettings.stride
    mode: Mode = MapSettings.mode
    linearize: Linearize | None = MapSettings.linearize
    camera_softness: float = MapSettings.camera_softness
    intensity_range: tuple[float, float] | None = None
    numerical_aperture: float | None = None
    wavelength: float | None = None
    immersion: str | None = None
    pixel_size: float | None = None

    def settings(self, *pictures: Path) -> MapSettings:
        """Return the settings that are asked for, checked; pictures may note a microscope."""
        asked = {each.name for each in fields(self)} & {each.name for each in fields(MapSettings)}
        values = {name: getattr(self, name) for name in asked}
        psf = microscope_text(self.lens(), self._microscope, pictures)
        settings = MapSettings(**values | {"psf": psf})
        settings.family()
        return settings

    def lens(self) -> str:
        """Return what stands for the PSF."""
        return self.psf

    @property
    def _microscope(self) -> dict[str, Any]:
        """What is given of a microscope, by the names of `Microscope`."""
        return {
            "numerical_aperture": self.numerical_aperture,
            "wavelength_um": self.wavelength,
            "pixel_size_um": self.pixel_size,
            "refractive_index": self.immersion,
        }


@dataclass(frozen=True, kw_only=True)
class MapOptions(EvidenceOptions):
    """What a map is measured with."""

    smoothness: float = MapSettings.smoothness
    color_sigma: float = MapSettings.color_sigma


@dataclass(frozen=True, kw_only=True)
class MapOrFileOptions(MapOptions):
    """What a map is measured with, or the file that it is in."""

    entries: ClassVar[dict[str, Entry]] = entries_in(f"""
        psf TEXT
            {SHARED["psf"].told} [default: {MapSettings.psf}, or that of the map that is given]
    """)

    psf: str | None = None  # type: ignore[assignment]  # left to the file
    known_map: Path | None = None
    map_confidence: Path | None = None

    @property
    def files(self) -> tuple[Path | None, Path | None]:
        """The map and its confidence, as far as they are given."""
        return self.known_map, self.map_confidence

    def lens(self) -> str:
        """Return the text of the PSF: as given, or else that of the file, or the default."""
        if self.psf is not None:
            return self.psf
        if self.known_map is None:
            return MapSettings.psf
        from napari_defocus.io.encoders import settings_in_tiff

        return str(settings_in_tiff(self.known_map).get("psf", MapSettings.psf))

    def find(self, picture: NDArray[Any], settings: MapSettings, progress: Progress) -> Measurement:
        """Return the map that is given, or else measure it."""
        return find_blur(picture, settings, self.intensity_range, *self.files, progress)


@dataclass(frozen=True, kw_only=True)
class RestorationOptions(OptionGroup):
    """What shapes a picture all in focus; its noise is that of the map."""

    tv_weight: float | None = RestorationSettings.tv_weight
    risk: float = RestorationSettings.risk

    def settings(self) -> RestorationSettings:
        """Return the settings that are asked for, checked."""
        return RestorationSettings(tv_weight=self.tv_weight, risk=self.risk)


@dataclass(frozen=True, kw_only=True)
class LimitOptions(OptionGroup):
    """Which fields of a batch are flagged."""

    in_focus_up_to: float = FieldLimits.in_focus_up_to
    min_share_in_focus: float = FieldLimits.min_share_in_focus
    min_share_known: float = FieldLimits.min_share_known
    max_share_saturated: float = FieldLimits.max_share_saturated
    max_one_direction: float = FieldLimits.max_one_direction

    def limits(self) -> FieldLimits:
        """Return the limits that are asked for, checked."""
        return FieldLimits(**vars(self))


@dataclass(frozen=True, kw_only=True)
class Reporting(OptionGroup):
    """How a command says what it has done."""

    as_json: bool = False
    quiet: bool = False


def said_threshold(text: str) -> float | Literal["auto"]:
    """Return what --threshold says: a number of px, or that the picture shall say it."""
    if text == "auto":
        return "auto"
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"threshold is {text}; it takes a number of px, or auto") from None


def with_options(
    command: Callable[..., None], parameters: Sequence[inspect.Parameter], text: str
) -> Callable[..., None]:
    """Return a command for typer: a parameter that is a group becomes an option a field.

    Parameters
    ----------
    command : callable
        Called with keywords only.
    parameters : sequence of inspect.Parameter
        What it takes, annotated with types.
    text : str
        What is to be said of them, see `entries_in`, as far as `SHARED` has it not or otherwise.
    """
    own = entries_in(text)
    groups = {each.name: each.annotation for each in parameters if _is_group(each)}
    options = [option for each in parameters for option in _options(each, own)]

    def called_by_typer(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in fields(group)})
        command(**given)

    called: Any = called_by_typer
    called.__signature__ = inspect.Signature(options)
    called.__annotations__ = {each.name: each.annotation for each in options}
    return called_by_typer


def _is_group(parameter: inspect.Parameter) -> bool:
    return isinstance(parameter.annotation, type) and issubclass(parameter.annotation, OptionGroup)


def _options(parameter: inspect.Parameter, own: dict[str, Entry]) -> Iterator[inspect.Parameter]:
    name, default, taken = parameter.name, parameter.default, parameter.annotation
    if not _is_group(parameter):
        entry = own.get(name) or SHARED[name]
        is_option = parameter.kind is inspect.Parameter.KEYWORD_ONLY
        yield shown(name, taken, default, entry, is_option=is_option)
        return
    types = _types_of_fields(taken)
    entries = SHARED | taken.entries | own
    for field in fields(taken):
        yield shown(field.name, types[field.name], field.default, entries[field.name])


_types_of_fields = cache(get_type_hints)
