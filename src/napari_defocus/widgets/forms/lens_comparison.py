"""Which lens fits the picture, as fields: the question, the table, and the answer to take."""

from pathlib import Path

from magicgui.widgets import Label, PushButton, Widget

from napari_defocus import PSFEvidence

LONGEST_NAME = 22
"""In letters, of a lens in the table; a longer one would make the panel wide."""


class LensComparison:
    """The fields of a comparison of lenses.

    Attributes
    ----------
    button, table, best_button : magicgui widgets
        Start it, show it, and take the best of it.
    best : str
        What `psf_from_text` reads; "" if nothing was compared.
    """

    def __init__(self) -> None:
        self.best = ""
        self.button = PushButton(
            name="compare",
            text="Which lens fits?",
            tooltip="Compare how well several lenses explain the picture, and show the best.",
        )
        self.table = Label(name="comparison", label=" ", value="")
        self.best_button = PushButton(
            name="take_best",
            text="Take the best",
            tooltip="Fill the lens' fields with the best of the comparison.",
        )

    def fields(self) -> list[Widget]:
        """Return the fields, from top to bottom."""
        return [self.button, self.table, self.best_button]

    def show(self, rows: list[tuple[str, PSFEvidence]]) -> None:
        """Show lenses as text and their evidence, the best first."""
        self.best, _ = rows[0]
        self.table.value = _table(rows)
        self.best_button.text = f"Take the best: {_short(self.best)}"
        self.table.show()
        self.best_button.show()

    def forget(self) -> None:
        """Show nothing; only once the fields are in a form."""
        self.best = ""
        self.table.hide()
        self.best_button.hide()


def _short(lens: str) -> str:
    """Return a lens' text, and of a file's path the beginning of its name."""
    name = Path(lens).name
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def _table(rows: list[tuple[str, PSFEvidence]]) -> str:
    lines = ["<tr><th align='left'>lens</th><th>evidence</th><th align='right'>median</th></tr>"]
    for text, row in rows:
        cells = f"{row.log_evidence:.2f}", f"{row.median_scale:.1f} px"
        numbers = "".join(f"<td align='right'>&nbsp;&nbsp;{cell}</td>" for cell in cells)
        lines.append(f"<tr><td>{_short(text)}</td>{numbers}</tr>")
    return f"<table>{''.join(lines)}</table>"
