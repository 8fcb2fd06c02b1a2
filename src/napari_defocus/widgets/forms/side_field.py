"""The choice between behind and before the focus, which no picture can make."""

from magicgui.widgets import ComboBox, Label

from napari_defocus.core.checks import Side

SIDES: dict[str, Side] = {"behind what is in focus": "far", "before what is in focus": "near"}

_AMBIGUITY = (
    "One picture cannot tell on which side of the focus something blurred lies. "
    "You choose, for the whole picture."
)


def side_field(value: Side) -> ComboBox:
    """Return the choice of a side."""
    return ComboBox(
        name="side",
        label="blurred things lie",
        choices=list(SIDES.items()),
        value=value,
        tooltip=_AMBIGUITY,
    )


def side_note() -> Label:
    """Return what there is to know about the choice; `wrap` it in the form."""
    return Label(
        name="side_note", label=" ", value="One picture cannot tell on which side: you choose."
    )
