"""Settings files on the command line: read below the options that are given, and written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from napari_defocus.cli.console import errors_in_one_line
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings

if TYPE_CHECKING:
    from napari_defocus.io.settings_file import Settings

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
"""What each command takes from a settings file; of one option in two parts, the later says it."""

_RIVAL_OF = {
    "noise_variance": "shot_noise",
    "shot_noise": "noise_variance",
    "focus": "sharp_at",
    "psf": "known_map",
}
"""Given on the command line, the second says what the first would say."""


class SettingsCommand(TyperCommand):
    """A command with --settings: what is given as options wins over the file."""

    def invoke(self, ctx: Any) -> Any:
        """Fill the options that are not given from the settings file, and run."""
        path = ctx.params["settings_file"]
        if path is not None:
            with errors_in_one_line():
                ctx.params |= _left_to_file(str(self.name), _said(path), ctx)
        return super().invoke(ctx)


def with_settings(outputs: list[Path], save_settings: Path | None) -> list[Path]:
    """Return the files that a command will write, its settings' file included."""
    return outputs if save_settings is None else [*outputs, save_settings]


def saved_settings(path: Path | None, command: str, settings: Settings) -> dict[Path, bytes]:
    """Return the file of the settings that a command has used, as `write_results` takes it.

    Parameters
    ----------
    path : Path or None
        Where it shall be; None for nowhere.
    command : str
        Only what its options say is written: a file says nothing of what was not used.
    settings : Settings
    """
    if path is None:
        return {}
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
    return {path: encoded_settings(parts)}


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


def _said(path: Path) -> dict[str, dict[str, Any]]:
    from napari_defocus.io.settings_file import said_in

    return said_in(path)


def _left_to_file(
    command: str, said: Mapping[str, Mapping[str, Any]], ctx: typer.Context
) -> dict[str, Any]:
    """Return the options that a file says, and neither themselves nor a rival are given."""
    options = {
        option: said[part][key]
        for option, (part, key) in _places(command).items()
        if key in said.get(part, {})
    }
    if "restoration" in PARTS_OF[command] and not _given(ctx, "noise_variance"):
        _check_one_noise(said)
    if "encoding" in options:
        options["encoding"] = options["encoding"] or "linear"
    return {
        option: value
        for option, value in options.items()
        if not _given(ctx, option) and not _rivalled(ctx, option)
    }


def _given(ctx: typer.Context, option: str) -> bool:
    source = ctx.get_parameter_source(option)
    return source is not None and source.name == "COMMANDLINE"


def _rivalled(ctx: typer.Context, option: str) -> bool:
    rival = _RIVAL_OF.get(option, "")
    if option != "psf":
        return _given(ctx, rival)
    if ctx.params.get(rival) is None:
        return False
    from napari_defocus.io.encoders import settings_in_tiff

    return "psf" in settings_in_tiff(ctx.params[rival])


def _check_one_noise(said: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse another noise for the restoration than for the map: one option says both."""
    restoring = said.get("restoration", {}).get("noise_variance")
    measuring = said.get("map", {}).get("noise_variance")
    if restoring is not None and restoring != measuring:
        raise ValueError(
            f'noise_variance of "restoration" is {restoring} and that of "map" {measuring}; '
            "this command takes one for both, for instance as --noise-variance"
        )
