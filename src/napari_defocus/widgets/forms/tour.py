"""A tour through the main job, for whoever opens the dock for the first time."""

from collections.abc import Callable

from qtpy.QtCore import Qt
from qtpy.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QVBoxLayout

from napari_defocus.widgets.display.dock_state import Stage
from napari_defocus.widgets.display.tour_notes import NOTES, followed

SKIP = "No tour"

_FRAME = "#tour { border: 1px solid #3d9be9; border-radius: 3px; }"


class Tour(QFrame):
    """A note at a time, with a button that leads on and one that ends the tour.

    Parameters
    ----------
    open_sample : callable
        What the button of the first note does.
    end : callable
        Called when the tour is over, or was refused.

    Attributes
    ----------
    step : int
        Which note is shown, from 0.
    """

    def __init__(self, open_sample: Callable[[], None], end: Callable[[], None]) -> None:
        super().__init__()
        self._open_sample, self._end = open_sample, end
        self.setObjectName("tour")
        self.setStyleSheet(_FRAME)
        self.text = QLabel()
        self.text.setWordWrap(True)
        self.on, self.skip = QPushButton(), QPushButton(SKIP)
        self.skip.setToolTip("It can be had again: File > Preferences, page Defocus.")
        for button in (self.on, self.skip):
            button.setFocusPolicy(Qt.StrongFocus)
        self.on.clicked.connect(lambda: self._lead_on())
        self.skip.clicked.connect(lambda: self._end())
        self._lay_out()
        self._show(0)

    def _lay_out(self) -> None:
        buttons = QHBoxLayout()
        buttons.addWidget(self.on)
        buttons.addWidget(self.skip)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(8, 6, 8, 6)
        layout.addWidget(self.text)
        layout.addLayout(buttons)

    def follow(self, stage: Stage) -> None:
        """Go on if what the note asks for was done."""
        step = followed(self.step, stage)
        if step != self.step:
            self._show(step)

    def _lead_on(self) -> None:
        if self.step == 0:
            self._open_sample()
        elif self.step + 1 < len(NOTES):
            self._show(self.step + 1)
        else:
            self._end()

    def _show(self, step: int) -> None:
        self.step, note = step, NOTES[step]
        self.text.setText(note.text)
        self.on.setText(note.button)
        self.on.setVisible(bool(note.button))
        for button in (self.on, self.skip):
            button.setAccessibleName(button.text())
            button.setAccessibleDescription(note.text)
        self.skip.setVisible(step + 1 < len(NOTES))
