"""What the user has set in napari's Preferences: with what forms begin.

No Qt here, as in `layers`. The choices and their defaults are in the manifest.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

from napari.settings import get_plugin_settings
from napari.utils.notifications import show_warning

from napari_defocus import Settings
from napari_defocus.core.checks import check_confidence, check_threshold_or_auto
from napari_defocus.settings import CONFIDENT, MapSettings, MaskSettings

PLUGIN = "napari-defocus"

THRESHOLD_OF_THE_PICTURE = 0.0
"""The number in Preferences, which take no word, that lets the picture say the threshold."""


@dataclass(frozen=True, kw_only=True)
class DisplaySettings:
    """How results are shown.

    Attributes
    ----------
    min_confidence : float
        The map is dimmed where its confidence is below, in [0, 1].
    live : bool
        Whether results follow the settings while they are changed.
    keep_earlier : bool
        Whether new results are put beside earlier ones, not in their place.
    """

    min_confidence: float = CONFIDENT
    live: bool = True
    keep_earlier: bool = False

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_confidence("min_confidence", self.min_confidence)


_Part = TypeVar("_Part", MapSettings, MaskSettings, DisplaySettings)


def preferred_settings() -> Settings:
    """Return the settings that forms begin with: those of Preferences, defaults for the rest.

    A value that cannot be, because somebody has edited the file or a measured lens is gone, has
    its default, and a warning says so. Where napari does not know the plugin, all are defaults.
    """
    explicit = _explicit()
    estimation = _possible(MapSettings(), explicit.get("map", {}))
    mask = _possible(MaskSettings(), explicit.get("mask", {}))
    largest = estimation.family().max_scale
    try:
        check_threshold_or_auto(mask.threshold, largest)
    except ValueError as reason:
        _warn(reason)
        mask = replace(mask, threshold=MaskSettings.threshold)
    return Settings(map=estimation, mask=mask)


def preferred_display() -> DisplaySettings:
    """Return how results are shown, as `preferred_settings` returns what shapes them."""
    return _possible(DisplaySettings(), _explicit().get("display", {}))


def wants_tour() -> bool:
    """Tell whether the tour is to be shown: until it was seen or refused, and never in tests."""
    return _explicit().get("tour", {}).get("shown", False) is True


def end_tour() -> None:
    """Remember that the tour was seen or refused."""
    try:
        get_plugin_settings(PLUGIN).tour.shown = False
    # There is nothing to remember it in: of a tour, no more is to be said than that.
    except Exception as error:
        _warn(error)


def _explicit() -> dict[str, dict[str, Any]]:
    """Return what Preferences say, part by part; nothing where napari knows no such plugin."""
    try:
        return get_plugin_settings(PLUGIN).model_dump()
    except KeyError:
        return {}
    # Whatever an edited file leads napari into.
    except Exception as error:
        _warn(error)
        return {}


def _possible(part: _Part, explicit: dict[str, Any]) -> _Part:
    """Return a part with all that is said and can be; each thing that cannot is warned of."""
    for key, value in explicit.items():
        if key == "threshold" and value == THRESHOLD_OF_THE_PICTURE:
            continue
        try:
            changed = replace(part, **{key: value})
            if isinstance(changed, MapSettings):
                changed.family()
            part = changed
        except (TypeError, ValueError) as reason:
            _warn(reason)
    return part


def _warn(reason: Exception) -> None:
    why = str(reason).rstrip(".") or type(reason).__name__
    show_warning(f"Preferences of Defocus: {why}. The default is used instead.")
