"""Settings kept in a file: JSON that people can read, edit and pass on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from types import NoneType
from typing import Any, Self, get_args, get_type_hints

import napari_defocus
from napari_defocus.core.checks import check_stride
from napari_defocus.core.writing import write_results
from napari_defocus.psf import BLUR_RADIUS
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings

VERSION_KEY = "napari_defocus"
"""The key under which a file says which version wrote it."""

UNIT_KEY = "unit"
"""The key under which a file says what its px mean: for some lenses, they once meant something
else.
"""

_NAME_OF_TYPE = {
    bool: "true or false",
    float: "a number",
    int: "a whole number",
    str: "a text",
    NoneType: "null",
}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything that shapes results, as one value that a file can keep.

    Parameters
    ----------
    map, mask, restoration, refocus
        See the attributes; each has its defaults if it is left out.

    Attributes
    ----------
    map : MapSettings
        What shapes the candidates and the blur map.
    mask : MaskSettings
        What shapes the in-focus mask.
    restoration : RestorationSettings
        What shapes the all-in-focus picture.
    refocus : RefocusSettings
        What shapes the picture with another focus.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from napari_defocus.settings import MaskSettings
    >>> settings = Settings(mask=MaskSettings(threshold=1.5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     settings.save(pathlib.Path(folder, "sharp.json"))
    ...     Settings.load(pathlib.Path(folder, "sharp.json")) == settings
    True
    """

    map: MapSettings = field(default_factory=MapSettings)
    mask: MaskSettings = field(default_factory=MaskSettings)
    restoration: RestorationSettings = field(default_factory=RestorationSettings)
    refocus: RefocusSettings = field(default_factory=RefocusSettings)

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write the settings into a JSON file, whole or not at all.

        Parameters
        ----------
        path : path-like
        force : bool, optional
            Whether a file that exists is overwritten.

        Raises
        ------
        TypeError
            If a setting is what no file can hold, or `force` is neither True nor False.
        OSError
            If the file exists and `force` is not set, or cannot be written; the message
            has the path and the reason.
        """
        write_results({Path(path): encoded_settings(asdict(self))}, force=force)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read settings that `save` wrote, or that were edited.

        Parts and keys that are missing have their defaults. A measured lens (.npz) is not opened
        yet; a relative path of it counts from the folder where it is used.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not JSON, or a part, a key or a value cannot be; the message has the file,
            the key, what it got and what it takes.
        """
        said = said_in(path)
        return cls(**{part: _PARTS[part](**values) for part, values in said.items()})


_PARTS: dict[str, type[Any]] = get_type_hints(Settings)


def encoded_settings(parts: Mapping[str, Mapping[str, Any]]) -> bytes:
    """Return what a settings file with these parts, or some of their keys, holds."""
    content = {VERSION_KEY: napari_defocus.__version__, UNIT_KEY: BLUR_RADIUS, **parts}
    try:
        text = json.dumps(content, indent=2, ensure_ascii=False)
    except TypeError:
        raise TypeError(f"{_not_for_json(parts)}; it takes numbers, text and bool") from None
    return f"{text}\n".encode()


def _not_for_json(parts: Mapping[str, Mapping[str, Any]]) -> str:
    """Return which key holds what."""
    for part, values in parts.items():
        for key, value in values.items():
            if not isinstance(value, str | int | float | None):
                return f"{part}.{key} is {value!r}"
    return "a key is not text"


def said_in(path: str | PathLike[str]) -> dict[str, dict[str, Any]]:
    """Return what a settings file says, part by part: no more than it does, all of it checked.

    Raises
    ------
    FileNotFoundError, ValueError
        As `Settings.load`.
    """
    try:
        content = _json_object("it", json.loads(_text(Path(path)), parse_constant=_refuse_constant))
        written_by = content.pop(VERSION_KEY, "")
        _check_type(f'"{VERSION_KEY}"', written_by, str)
        unit = content.pop(UNIT_KEY, "" if written_by else BLUR_RADIUS)
        _check_names("part", content, _PARTS)
        said = {part: _checked_part(part, values) for part, values in content.items()}
        _check_unit(unit, said.get("map", {}).get("psf", MapSettings.psf))
        return said
    except FileNotFoundError:
        raise FileNotFoundError(f"cannot read {path}: there is no such file") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"cannot read {path}: it is not JSON ({error})") from None
    except UnicodeDecodeError:
        raise ValueError(f"cannot read {path}: it is not JSON, which is UTF-8 text") from None
    except RecursionError:
        raise ValueError(f"cannot read {path}: it is nested too deeply for settings") from None
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from None


def _check_unit(unit: str, psf: str) -> None:
    """Refuse px of lenses that had another unit once; those of discs and measured ones stay."""
    if unit != BLUR_RADIUS and psf.lower() != "disc" and not psf.lower().endswith(".npz"):
        raise ValueError(
            f'its px are in an early unit of the lens "{psf}"; make its largest radius and '
            f"threshold blur radii (twice the standard deviation) and add "
            f'"{UNIT_KEY}": "{BLUR_RADIUS}"'
        )


def _text(path: Path) -> str:
    if path.is_dir():
        raise ValueError("it is a folder; settings are read from a JSON file")
    # Some editors begin UTF-8 files with a mark.
    return path.read_text(encoding="utf-8-sig")


def _refuse_constant(name: str) -> None:
    raise ValueError(f"it has the value {name}; it takes finite numbers")


def _json_object(what: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what} is {json.dumps(value):.40}; it takes an object, {{...}}")
    return value


def _check_names(kind: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    for name in given:
        if name not in known:
            raise ValueError(f'it has the {kind} "{name}"; it takes {", ".join(known)}')


def _checked_part(part: str, values: Any) -> dict[str, Any]:
    """Return what a file says in a part, numbers as the settings class has them."""
    settings = _PARTS[part]
    types = get_type_hints(settings)
    values = _json_object(f'"{part}"', values)
    _check_names(f'key of "{part}"', values, types)
    for key, value in values.items():
        _check_type(f'"{key}" of "{part}"', value, types[key])
    try:
        values = {key: _as_float(value, types[key]) for key, value in values.items()}
        possible = settings(**values)
        if isinstance(possible, MapSettings):
            _check_estimation(possible)
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(f'in "{part}", {error}') from None
    return values


def _check_type(what: str, value: Any, taken: Any) -> None:
    if any(_fits(value, choice) for choice in _choices(taken)):
        return
    names = (_NAME_OF_TYPE.get(choice, f'"{choice}"') for choice in _choices(taken))
    got = json.dumps(value, ensure_ascii=False)
    raise ValueError(f"{what} is {got:.60}; it takes {' or '.join(names)}")


def _choices(taken: Any) -> tuple[Any, ...]:
    """Return the types that an annotation takes, and the texts."""
    return tuple(each for part in get_args(taken) for each in _choices(part)) or (taken,)


def _fits(value: Any, choice: Any) -> bool:
    if isinstance(choice, str):
        return bool(value == choice)
    return type(value) is choice or (choice is float and type(value) is int)


def _as_float(value: Any, taken: Any) -> Any:
    """Return a whole number as a float where fractions are taken, too."""
    return float(value) if type(value) is int and float in _choices(taken) else value


def _check_estimation(settings: MapSettings) -> None:
    """Check what is otherwise found out when a picture is there."""
    from napari_defocus.likelihood.exact_spectra import check_side
    from napari_defocus.psf.parsing import psf_of

    # The file of a measured lens may be elsewhere now, or another lens be asked for.
    text = "disc" if settings.psf.lower().endswith(".npz") else settings.psf
    psf_of(text, settings.max_radius)
    check_side(settings.window)
    check_stride(settings.stride, settings.window)
