"""TOML as it is written: tables of values, and of tables inside them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["toml_text", "toml_value"]


def toml_text(table: Mapping[str, Any]) -> str:
    """The text of a file that says a table."""
    return "\n".join(_lines(table, "")).lstrip("\n") + "\n"


def toml_value(value: Any) -> str:
    """A value as TOML has it."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(value)


def _lines(table: Mapping[str, Any], name: str) -> Iterator[str]:
    """Lines of a TOML table: values first, then the tables inside it."""
    for key, value in table.items():
        if not _is_table(value):
            yield f"{key} = {toml_value(value)}"
    for key, value in table.items():
        full = f"{name}.{key}" if name else key
        if isinstance(value, dict):
            yield from ("", f"[{full}]", *_lines(value, full))
        elif _is_table(value):
            for one in value:
                yield from ("", f"[[{full}]]", *_lines(one, full))


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and isinstance(value[0], dict))
