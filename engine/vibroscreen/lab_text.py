"""Text files as laboratories and spreadsheets write them."""

from __future__ import annotations

__all__ = ["decoded"]


def decoded(raw: bytes) -> str | None:
    """The text of a file, in the encoding that its bytes say; None if it is no text."""
    wide = raw.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    return None
