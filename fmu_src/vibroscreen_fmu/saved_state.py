"""A saved state in bytes, the same for both runtimes: a head, and all that a model remembers."""

from __future__ import annotations

import struct
import zlib
from hashlib import sha256

from vibroscreen.errors import told

__all__ = ["owner_of", "packed", "unpacked"]

# Mark and version, build that it belongs to; whether it runs, time [s]; checksum of all that
# follows the build.
_HEAD, _SAID = struct.Struct("<8s16sQdQ"), struct.Struct("<Qd")
_MARK = b"vscreen2"  # that of vibroscreen/native/header.py


def owner_of(build: str) -> bytes:
    """Sixteen bytes that only states of a build have."""
    return sha256(build.encode()).digest()[:16]


def packed(build: str, running: bool, time: float, body: bytes) -> bytes:
    """The state of an instance of a build, at a time [s]."""
    checksum = zlib.crc32(body, zlib.crc32(_SAID.pack(running, time)))
    return _HEAD.pack(_MARK, owner_of(build), running, time, checksum) + body


def unpacked(build: str, name: str, state: bytes) -> tuple[bool, float, bytes]:
    """Whether it runs, its time [s] and the rest of a state of a build of the model `name`.

    Raises ValueError for what is none.
    """
    head, body = state[: _HEAD.size], state[_HEAD.size :]
    if len(head) < _HEAD.size or not head.startswith(_MARK):
        raise ValueError(told("no_state", value=len(state), name=name))
    _, owner, running, time, checksum = _HEAD.unpack(head)
    if owner != owner_of(build):
        raise ValueError(told("other_build", value=len(state)))
    if checksum != zlib.crc32(body, zlib.crc32(_SAID.pack(running, time))):
        raise ValueError(told("broken_state", value=len(state)))
    return bool(running), time, body
