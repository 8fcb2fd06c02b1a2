"""Settings files on the command line: read below the options that are given, and written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from napari_defocus.cli.console import errors_in_one_line
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings

if TYPE_CHECKING:
    from napari_defocus.io.settings_file import Settings

Said = Mapping[str, Mapping[str, Any]]

PARTS_OF: dict[str, dict[str, type[Any]]] = {
    "map": {"map": MapSettings},
    "segment": {"map": MapSettings, "mask": MaskSettings},
    "restore": {"restoration": RestorationSettings, "map": MapSettings},
    "refocus": {
        "refocus": RefocusSettings,
        "restoration": RestorationSettings,
        "map": MapSettings,
    },
    "depth": {"map": MapSettings},
    "explain": {"map": MapSettings},
    "batch": {"restoration": RestorationSettings, "mask": MaskSettings, "map": MapSettings},
}
"""What each command takes from a settings file. If one option is in two parts, the later one
counts.
"""

_RIVAL_OF = {
    "noise_variance": "shot_noise",
    "shot_noise": "noise_variance",
    "focus": "sharp_at",
    "psf": "known_map",
}
"""If the second option is given on the command line, the first one of the file does not count."""


def options_from_file(ctx: typer.Context, path: Path | None) -> Path | None:
    """Let a settings file say what the options of a command do not: the callback of --settings.

    Options that are not given are asked for last, so that what is given is known then.
    """
    if path is not None:
        from napari_defocus.io.settings_file import said_in

        with errors_in_one_line():
            said = said_in(path)
        ctx.default_map = {
            option: partial(_left_to_file, ctx, said, option, said.get(part, {}).get(key))
            for option, (part, key) in _places(str(ctx.info_name)).items()
            # Always looked up, to notice a file that gives the noise twice.
            if key in said.get(part, {}) or option == "noise_variance"
        }
    return path


def saved_settings(command: str, settings: Settings) -> bytes:
    """Return the file of the settings that a command has used.

    Only what its options say is written: a file says nothing of what was not used.
    """
    from napari_defocus.io.settings_file import encoded_settings

    said = {*_places(command).values()}
    if "restoration" in PARTS_OF[command]:
        restoration = replace(settings.restoration, noise_variance=settings.map.noise_variance)
        settings = replace(settings, restoration=restoration)
        said.add(("restoration", "noise_variance"))
    parts = {
        part: {key: value for key, value in values.items() if (part, key) in said}
        for part, values in asdict(settings).items()
        if part in PARTS_OF[command]
    }
    return encoded_settings(parts)


def _places(command: str) -> dict[str, tuple[str, str]]:
    """Return in which part and under which key each option of a command is."""
    return {
        "encoding" if (part, field.name) == ("refocus", "linearize") else field.name: (
            part,
            field.name,
        )
        for part, settings in PARTS_OF[command].items()
        for field in fields(settings)
    }


def _left_to_file(ctx: typer.Context, said: Said, option: str, value: Any) -> Any:
    """Return what a file says of an option that is not given, but its default if a rival is."""
    with errors_in_one_line():
        if option == "noise_variance" and "restoration" in PARTS_OF[str(ctx.info_name)]:
            _check_one_noise(said)
        if option == "encoding":
            return value or "linear"
        if _rivalled(ctx, option):
            return False if option == "shot_noise" else None
        return value


def _rivalled(ctx: typer.Context, option: str) -> bool:
    rival = _RIVAL_OF.get(option, "")
    source = ctx.get_parameter_source(rival)
    if source is None or source.name != "COMMANDLINE":
        return False
    if option != "psf":
        return True
    from napari_defocus.io.encoders import settings_in_tiff

    return "psf" in settings_in_tiff(ctx.params[rival])


def _check_one_noise(said: Said) -> None:
    """Refuse another noise for the restoration than for the map: one option says both."""
    restoring = said.get("restoration", {}).get("noise_variance")
    measuring = said.get("map", {}).get("noise_variance")
    if restoring is not None and restoring != measuring:
        raise ValueError(
            f'noise_variance of "restoration" is {restoring} and that of "map" {measuring}; '
            "this command takes one for both, for instance as --noise-variance"
        )
