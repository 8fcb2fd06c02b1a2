"""The tour for whoever opens the dock for the first time."""

from pathlib import Path

import pytest
from napari.settings import get_plugin_settings
from npe2 import PluginManifest

import napari_defocus
from napari_defocus.widgets.docks import defocus
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.layers.preferences import PLUGIN, wants_tour

pytestmark = pytest.mark.display


@pytest.fixture
def newcomer(plugin_settings, npe2pm):
    """Somebody whose Preferences are as after installing."""
    file = Path(napari_defocus.__file__).with_name("napari.yaml")
    npe2pm.register(PluginManifest.from_file(file))
    return get_plugin_settings(PLUGIN)


def test_tour_leads_from_a_sample_to_the_end_and_does_not_come_again(
    newcomer, viewer, opened, finish, method, texture, monkeypatch
):
    sample = texture, {"name": "dandelion"}, "image"
    monkeypatch.setattr(defocus, "dandelion", lambda: [sample])
    widget = opened(DefocusWidget)
    tour, notes = widget.tour, []
    notes.append(tour.text.text())
    tour.on.click()
    assert [layer.name for layer in viewer.layers] == ["dandelion"]
    assert widget.image.value is viewer.layers["dandelion"]
    notes.append(tour.text.text())
    assert tour.on.isHidden(), "only measuring leads on"
    finish(widget)
    notes.append(tour.text.text())
    for _ in range(2):
        tour.on.click()
        notes.append(tour.text.text())
    assert len(set(notes)) == 5
    tour.on.click()
    assert widget.tour is None
    assert tour.isHidden()
    assert not wants_tour()
    assert opened(DefocusWidget).tour is None


def test_tour_is_refused_with_one_press(newcomer, opened):
    widget = opened(DefocusWidget)
    widget.tour.skip.click()
    assert widget.tour is None
    assert not newcomer.tour.shown


def test_whoever_has_a_picture_is_not_offered_another(newcomer, viewer, opened, texture):
    viewer.add_image(texture, name="leaf")
    assert opened(DefocusWidget).tour.step == 1


def test_there_is_no_tour_where_napari_knows_no_preferences(opened):
    assert opened(DefocusWidget).tour is None
