"""How planes were laid on each other, kept in a file for another channel, as fields."""

from pathlib import Path

from magicgui.widgets import FileEdit, PushButton, Widget

from napari_defocus import StackAlignment


class AlignmentFields:
    """The choice of a saved alignment, and the button that saves one.

    Attributes
    ----------
    use : magicgui.widgets.FileEdit
        The file of the alignment that is used; none measures the motion.
    save_button : magicgui.widgets.PushButton
    """

    def __init__(self) -> None:
        self.use = FileEdit(
            name="use_alignment",
            label="saved alignment",
            filter="Alignments (*.json)",
            nullable=True,
            value=None,
            tooltip="Lay the planes on each other as it was done before: for another channel of "
            "this stack, choose the file that “Save alignment…” or the terminal wrote. Without "
            "one, the motion is measured.",
        )
        self.use.line_edit.native.setPlaceholderText("measure it")
        self.save_button = PushButton(
            name="save_alignment",
            text="Save alignment…",
            tooltip="Save how the planes were laid on each other (.json), to use it for another "
            "channel, here or in the terminal.",
        )

    def fields(self) -> list[Widget]:
        """Return the fields, from top to bottom."""
        return [self.use, self.save_button]

    @property
    def is_chosen(self) -> bool:
        """Whether a file is chosen."""
        return str(self.use.value or "").strip() not in ("", ".")

    def alignment(self) -> StackAlignment | None:
        """Return the alignment that was chosen; None measures it.

        Raises
        ------
        ValueError
            If the file cannot be read, or holds no alignment.
        """
        if not self.is_chosen:
            return None
        try:
            return StackAlignment.load(Path(str(self.use.value)))
        except FileNotFoundError as reason:
            raise ValueError(str(reason)) from None
