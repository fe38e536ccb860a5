"""TOML as it is read and written: tables of values, and of tables inside them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vibroscreen.errors import ConfigError

__all__ = ["text_of", "toml_text", "toml_tree", "toml_value"]


def text_of(path: Path) -> str:
    """The text of a file. Raises ConfigError if it is none, OSError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ConfigError(f"{path.name} is not text in UTF-8: save it in this encoding") from None


def toml_tree(text: str) -> dict[str, Any]:
    """The tree of a TOML text. Raises ConfigError if it is none."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"the text is not TOML ({error}): correct it there") from None


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
