"""What napari's Preferences say is what forms begin with; what cannot be does no harm."""

from pathlib import Path

import numpy as np
import pytest
from napari.settings import get_plugin_settings
from npe2 import PluginManifest

import napari_defocus
from napari_defocus import Disc, MeasuredPSF, Settings
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.layers.preferences import (
    PLUGIN,
    THRESHOLD_OF_THE_PICTURE,
    DisplaySettings,
    preferred_display,
    preferred_settings,
)

MANIFEST = PluginManifest.from_file(Path(napari_defocus.__file__).with_name("napari.yaml"))
PARTS = {"map": MapSettings, "mask": MaskSettings, "display": DisplaySettings}


@pytest.fixture
def preferences(plugin_settings, npe2pm):
    """What Preferences change."""
    npe2pm.register(MANIFEST)
    return get_plugin_settings(PLUGIN)


@pytest.fixture
def edited(plugin_settings, npe2pm, tmp_path):
    """Edit the file in which napari keeps them, before it reads it."""

    def edit(text):
        (tmp_path / f"{PLUGIN}.yaml").write_text(text)
        npe2pm.register(MANIFEST)

    return edit


@pytest.mark.parametrize("part", PARTS)
def test_defaults_of_the_manifest_are_those_of_the_settings(part):
    properties = MANIFEST.contributions.configurations[part].properties
    assert properties
    for key, said in properties.items():
        default = getattr(PARTS[part], key)
        expected = THRESHOLD_OF_THE_PICTURE if default == "auto" else default
        assert said.default == expected, key


def test_without_the_plugin_in_napari_there_are_defaults(plugin_settings, messages):
    assert preferred_settings() == Settings()
    assert preferred_display() == DisplaySettings()
    assert not messages()


def test_untouched_preferences_are_defaults(preferences, messages):
    assert preferred_settings() == Settings()
    assert preferred_display() == DisplaySettings(min_confidence=0.5, live=True, keep_earlier=False)
    assert not messages()


def test_what_is_preferred_is_what_forms_begin_with(preferences):
    preferences.map.psf = "polygon:6"
    preferences.map.max_radius = 5.5
    preferences.map.smoothness = 7.0
    preferences.mask.threshold = 1.5
    preferences.mask.color_sigma = 0.02
    preferences.display.min_confidence = 0.7
    preferences.display.live = False
    preferences.display.keep_earlier = True
    assert preferred_settings() == Settings(
        map=MapSettings(psf="polygon:6", max_radius=5.5, smoothness=7.0),
        mask=MaskSettings(threshold=1.5, color_sigma=0.02),
    )
    assert preferred_display() == DisplaySettings(min_confidence=0.7, live=False, keep_earlier=True)


def test_they_are_remembered(edited):
    edited("map:\n  max_radius: 6\n  color_sigma: 0.035\n")
    assert preferred_settings().map == MapSettings(max_radius=6.0, color_sigma=0.035)


def test_measured_lens_that_is_gone_is_warned_of(preferences, messages, tmp_path):
    lens = tmp_path / "lens.npz"
    MeasuredPSF([1, 4], [np.pad(Disc().kernel(1), 3), Disc().kernel(4)]).save(lens)
    preferences.map.psf = str(lens)
    assert preferred_settings().map.psf == str(lens)
    assert not messages()
    lens.unlink()
    assert preferred_settings() == Settings()
    [message] = messages()
    assert "no such file" in message
    assert "The default is used instead." in message


def test_lens_that_cannot_be_leaves_the_rest_as_it_is(preferences, messages):
    preferences.map.psf = "square"
    preferences.map.max_radius = 5.0
    assert preferred_settings().map == MapSettings(max_radius=5.0)
    [message] = messages()
    assert "square" in message


def test_threshold_beyond_the_largest_radius_is_warned_of(preferences, messages):
    preferences.map.max_radius = 5.0
    preferences.mask.threshold = 6.0
    assert preferred_settings().mask == MaskSettings()
    [message] = messages()
    assert "threshold is 6" in message


@pytest.mark.parametrize(
    "text",
    [
        "map:\n  max_radius: -3\n",
        "map:\n  max_radius: wide\n",
        "map:\n  max_radius: .nan\n",
        "map: 3\n",
        "mask:\n  color_sigma: 0\n",
        "map:\n  color_sigma:\n",
        "display:\n  min_confidence: 7\n",
        "display:\n  live: perhaps\n",
        "radius: 3\n",
        "[1, 2]\n",
        "map: {\n",
        "",
    ],
)
def test_edited_file_never_ends_in_an_error(edited, text):
    edited(text)
    assert preferred_settings() == Settings()
    assert preferred_display() == DisplaySettings()
