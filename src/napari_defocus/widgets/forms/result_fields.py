"""How results are shown, as fields: defaults are read from Preferences."""

from pathlib import Path

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, FileEdit, PushButton
from napari.components import ViewerModel
from napari.layers import Labels

from napari_defocus.widgets.layers.preferences import DisplaySettings
from napari_defocus.widgets.layers.result_metadata import made_by_us
from napari_defocus.widgets.layers.result_stores import UNTIL_CLOSED, Place
from napari_defocus.widgets.layers.seeds import SEEDS


def live_field(display: DisplaySettings) -> CheckBox:
    """Return the choice whether labels follow the sliders."""
    return CheckBox(
        name="live",
        text="follow the sliders",
        value=display.live,
        tooltip="Once the picture is measured, label it again whenever a slider or the seeds "
        "change: a rough map and mask at once, the fine ones when the slider rests.",
    )


def keep_earlier_field(display: DisplaySettings) -> CheckBox:
    """Return the choice whether the results of earlier runs stay."""
    return CheckBox(
        name="keep_earlier",
        text="keep earlier results",
        value=display.keep_earlier,
        tooltip="Put the results of a run beside those of earlier ones, with a number in their "
        "names, instead of updating these.",
    )


def keep_in_field() -> FileEdit:
    """Return the choice where results too large for memory are kept; nothing is the usual one."""
    field = FileEdit(
        name="keep_in",
        label="keep in",
        mode=FileDialogMode.EXISTING_DIRECTORY,
        nullable=True,
        value=None,
        tooltip="This picture is large: it is measured part by part, and its results are kept on "
        "the disk, as OME-Zarr. Choose a folder for them; without one, they are gone when "
        "napari is closed.",
    )
    field.line_edit.native.setPlaceholderText("until napari is closed")
    return field


def place_of(keep_in: FileEdit) -> Place:
    """Return where the field says that results are kept."""
    chosen = str(keep_in.value or "").strip()
    return Place(Path(chosen)) if chosen not in ("", ".") else UNTIL_CLOSED


def seeds_field(viewer: ViewerModel) -> ComboBox:
    """Return the choice of a labels layer that a mask keeps to."""
    return ComboBox(
        name="seeds",
        label="seeds",
        choices=lambda _: [
            layer
            for layer in viewer.layers
            if isinstance(layer, Labels) and made_by_us(layer) in (None, SEEDS)
        ],
        nullable=True,
        tooltip="A labels layer on the image that says what is known: 1 in focus, 2 blurred, "
        "0 not known. The mask keeps to it, and what looks alike around it follows. "
        "Changing it does not analyse the picture again.",
    )


def seeds_button() -> PushButton:
    """Return the button that makes such a layer."""
    return PushButton(
        name="new_seeds",
        text="New seeds layer",
        tooltip="Add a labels layer for the chosen image, ready to paint: label 1 where it is "
        "in focus, label 2 where it is blurred.",
    )
