"""The choice between the plane that is shown and all planes of a stack."""

from magicgui.widgets import ComboBox


class PlanesField(ComboBox):
    """The plane that is shown, or all planes of a stack."""

    def __init__(self) -> None:
        super().__init__(
            name="planes",
            label="planes",
            choices=[("the one shown", "shown"), ("all planes", "all")],
            value="shown",
            tooltip="Of a stack, analyse the plane that is shown, or all planes one after the "
            "other: over time and depth, wherever there is a slider. The results of all planes "
            "are stacks too.",
        )

    @property
    def all_planes(self) -> bool:
        """Whether all planes are chosen."""
        return bool(self.value == "all")
