"""Dialogs that ask where something is saved."""

from pathlib import Path

from qtpy.QtWidgets import QFileDialog, QWidget


def asked_where(parent: QWidget, title: str, suggested: str, kind: str) -> tuple[Path | None, bool]:
    """Ask for a file; also tell whether it may be replaced.

    Parameters
    ----------
    parent : QWidget
    title, suggested : str
        Of the dialog, and the name to begin with, whose ending all names get.
    kind : str
        What files are shown, such as "Tables (*.csv)".

    Returns
    -------
    path : Path or None
        None if the dialog was cancelled.
    overwrite : bool
    """
    chosen, _ = QFileDialog.getSaveFileName(parent, title, suggested, kind)
    if not chosen:
        return None, False
    # The dialog has asked about the name as it was typed only.
    path = Path(chosen)
    return (path, True) if path.suffix else (path.with_suffix(Path(suggested).suffix), False)
