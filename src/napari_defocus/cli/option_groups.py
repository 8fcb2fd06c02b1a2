"""Options that come together in several terminal commands: a dataclass a group.

A command takes a group as one parameter; `with_groups` shows typer an option for each of its
fields. What is new in a group is new in all commands that take it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from typing import Any, TypedDict, cast, get_type_hints

from napari_defocus.cli.options import (
    AsJson,
    ColorSigma,
    FNumber,
    FocalLength,
    FocusDistance,
    IntensityRange,
    KnownConfidence,
    KnownMap,
    LinearizeOption,
    MapSmoothness,
    MaxRadius,
    ModeOption,
    NoiseVariance,
    PixelPitch,
    PSFText,
    PSFTextOrMaps,
    Quiet,
    SavedSettings,
    SettingsFile,
    ShotNoiseOption,
    Stride,
    Window,
)
from napari_defocus.pipeline import psf_for
from napari_defocus.settings import MapSettings


class OptionGroup:
    """A dataclass whose fields are annotated as typer's options, and have defaults."""


@dataclass(frozen=True, kw_only=True)
class EvidenceOptions(OptionGroup):
    """What the evidence of windows is measured with."""

    psf: PSFText = MapSettings.psf
    noise_variance: NoiseVariance = MapSettings.noise_variance
    shot_noise: ShotNoiseOption = MapSettings.shot_noise
    max_radius: MaxRadius = MapSettings.max_radius
    window: Window = MapSettings.window
    stride: Stride = MapSettings.stride
    mode: ModeOption = MapSettings.mode
    linearize: LinearizeOption = MapSettings.linearize
    intensity_range: IntensityRange = None

    def settings(self) -> MapSettings:
        """Return the settings that are asked for, checked."""
        asked = {each.name for each in fields(self)} & {each.name for each in fields(MapSettings)}
        values = {name: getattr(self, name) for name in asked}
        settings = MapSettings(**values | {"psf": self.lens()})
        settings.family()
        return settings

    def lens(self) -> str:
        """Return what stands for the PSF."""
        return self.psf


@dataclass(frozen=True, kw_only=True)
class MapOptions(EvidenceOptions):
    """What a map is measured with."""

    smoothness: MapSmoothness = MapSettings.smoothness
    color_sigma: ColorSigma = MapSettings.color_sigma


@dataclass(frozen=True, kw_only=True)
class MapOrFileOptions(MapOptions):
    """What a map is measured with, or the file that it is in."""

    psf: PSFTextOrMaps = None  # type: ignore[assignment]  # left to the file
    known_map: KnownMap = None
    map_confidence: KnownConfidence = None

    def lens(self) -> str:
        """Return what stands for the PSF; if none is asked for, that of the file."""
        return psf_for(self.psf, self.known_map)


class GivenLens(TypedDict):
    """What is given of a lens, by the names of `ThinLens`; None is left to the picture's EXIF."""

    focal_length_mm: float | None
    f_number: float | None
    focus_distance_m: float | None
    pixel_pitch_um: float | None


@dataclass(frozen=True, kw_only=True)
class LensOptions(OptionGroup):
    """A thin lens."""

    focal_length: FocalLength = None
    f_number: FNumber = None
    focus_distance: FocusDistance = None
    pixel_pitch: PixelPitch = None

    @property
    def given(self) -> GivenLens:
        """What is given of it."""
        return GivenLens(
            focal_length_mm=self.focal_length,
            f_number=self.f_number,
            focus_distance_m=self.focus_distance,
            pixel_pitch_um=self.pixel_pitch,
        )


@dataclass(frozen=True, kw_only=True)
class SettingsFiles(OptionGroup):
    """Where settings are read from, by `SettingsCommand`, and written to."""

    settings_file: SettingsFile = None
    save_settings: SavedSettings = None


@dataclass(frozen=True, kw_only=True)
class Reporting(OptionGroup):
    """How a command says what it has done."""

    as_json: AsJson = False
    quiet: Quiet = False


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for typer: a parameter that is a group becomes an option a field.

    Parameters
    ----------
    command : callable
        Called with keywords only.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, type[Any]] = {}
    parameters = []
    for name, parameter in inspect.signature(command).parameters.items():
        annotation = hints[name]
        if isinstance(annotation, type) and issubclass(annotation, OptionGroup):
            groups[name] = annotation
            parameters += _parameters_of(annotation)
        else:
            named = parameter.replace(annotation=annotation, kind=inspect.Parameter.KEYWORD_ONLY)
            parameters.append(named)

    @wraps(command)
    def called_by_typer(**options: Any) -> None:
        given = {
            name: group(**{field.name: options.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        command(**options, **given)

    shown = cast(Any, called_by_typer)
    shown.__signature__ = inspect.Signature(parameters)
    shown.__annotations__ = {each.name: each.annotation for each in parameters}
    return called_by_typer


def _parameters_of(group: type[Any]) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=hints[field.name],
        )
        for field in fields(group)
    ]
