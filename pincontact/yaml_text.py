"""YAML as scene files use it: a key stands once in its mapping and is a text; numbers are those of YAML 1.2."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

_TAG = "tag:yaml.org,2002:"
# YAML 1.1 takes 1:30 for 90, 010 for 8 and 2020-01-01 for a date, and does not take 1e-3 for a number.
_NUMBERS = {
    "int": r"[-+]?(0|[1-9][0-9]*)",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
}
_REPLACED = (*_NUMBERS, "timestamp")


class KeysError(Exception):
    """A key stands twice in its mapping, is no text, or leads back to itself; the text says which, and in what line."""


def parse_yaml(text: str) -> Any:
    """The content of a YAML text.

    Raises ImportError without PyYAML, its YAMLError for what is no YAML, KeysError.
    """
    yaml = import_module("yaml")

    class Loader(yaml.SafeLoader):  # type: ignore[name-defined, misc]
        """With numbers of its own."""

    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in known if tag.removeprefix(_TAG) not in _REPLACED]
        for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    for name, pattern in _NUMBERS.items():
        Loader.add_implicit_resolver(_TAG + name, re.compile(f"(?:{pattern})$"), list("-+.0123456789"))
    node = yaml.compose(text, Loader=Loader)
    if node is not None:
        _check_keys(node, "", {})
    return yaml.load(text, Loader=Loader)


def _check_keys(node: Any, path: str, above: dict[int, str]) -> None:
    """above: the nodes that this one is within, by identity."""
    if id(node) in above:
        raise KeysError(f"{path or 'the file'}: line {_line(node)} contains itself")
    above = {**above, id(node): path}
    if node.id == "sequence":
        for i, item in enumerate(node.value):
            _check_keys(item, f"{path}[{i}]", above)
    elif node.id == "mapping":
        lines: dict[str, int] = {}
        for key, value in node.value:
            if key.tag == _TAG + "merge":
                _check_keys(value, path, above)
                continue
            where = f"{path}.{key.value}".lstrip(".") if key.id == "scalar" else path
            if key.tag != _TAG + "str":
                raise KeysError(f"{where}: line {_line(key)}: a key must be a text; put it in quotes")
            if key.value in lines:
                raise KeysError(f"{where}: given twice, in lines {lines[key.value]} and {_line(key)}")
            lines[key.value] = _line(key)
            _check_keys(value, where, above)


def _line(node: Any) -> int:
    return int(node.start_mark.line) + 1
