"""Messages between processes: a pickle and the arrays in it, as they lie in memory.

They are sent as the number of these parts, their sizes in bytes, and they themselves.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Iterator
from io import RawIOBase
from typing import IO, Any, cast

import numpy as np

Message = list[memoryview]

_PIECE = 2**20
"""Bytes that are written at once. It takes about a millisecond, so the sender can look up between.
"""

_NUMBER = struct.Struct("<Q")


def packed(value: Any) -> Message:
    """Return the message that says a value; its arrays are not copied."""
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(value, protocol=5, buffer_callback=arrays.append)
    return [memoryview(pickled), *(array.raw() for array in arrays)]


def unpacked(message: Message) -> Any:
    """Return the value that a message says; its arrays are those of the message."""
    return pickle.loads(message[0], buffers=message[1:])


def pieces(message: Message) -> Iterator[memoryview]:
    """Cut a message into what is written at once."""
    sizes = (len(message), *(len(part) for part in message))
    yield memoryview(b"".join(map(_NUMBER.pack, sizes)))
    for part in message:
        for start in range(0, len(part), _PIECE):
            yield part[start : start + _PIECE]


def write_piece(stream: IO[bytes], piece: memoryview) -> None:
    """Write all of a piece to a raw stream, which may take part of it at a time."""
    while piece:
        piece = piece[stream.write(piece) :]


def read_message(stream: IO[bytes]) -> Message | None:
    """Read a message into memory that its arrays may be changed in; None at the end."""
    try:
        [count] = _NUMBER.unpack(_read_bytes(stream, _NUMBER.size))
        sizes = [_NUMBER.unpack(_read_bytes(stream, _NUMBER.size))[0] for _ in range(count)]
        return [_read_bytes(stream, size) for size in sizes]
    except (EOFError, OSError):
        return None


def _read_bytes(stream: IO[bytes], size: int) -> memoryview:
    read = np.empty(size, np.uint8).data  # a bytearray would be filled with zeros first
    start = 0
    while start < size:
        count = cast(RawIOBase, stream).readinto(read[start:])
        if not count:
            raise EOFError
        start += count
    return read
