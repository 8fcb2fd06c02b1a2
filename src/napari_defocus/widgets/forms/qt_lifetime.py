"""What is done when a Qt widget is destroyed."""

import weakref
from collections.abc import Callable
from itertools import count
from typing import Any, TypeVar

from qtpy.QtWidgets import QWidget

T = TypeVar("T")

_waiting: dict[int, Callable[..., None]] = {}
_numbers = count()


def when_destroyed(widget: QWidget, owner: T, act: Callable[[T], None]) -> None:
    """Call ``act(owner)`` when a widget is destroyed, if the owner still lives.

    A garbage collector that takes both a widget and its callback may have taken the callback to
    pieces when the widget calls it, and PyQt crashes. This one is kept until it was called, and
    keeps neither of them.

    Parameters
    ----------
    widget : QWidget
    owner : object
    act : callable
        Of nothing that holds the widget or the owner.
    """
    number, reference = next(_numbers), weakref.ref(owner)

    def call(*_: Any) -> None:
        _waiting.pop(number, None)
        living = reference()
        if living is not None:
            act(living)

    _waiting[number] = call
    widget.destroyed.connect(call)
