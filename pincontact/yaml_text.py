"""YAML as scene files use it: a key stands once in its mapping and is a text; numbers are those of YAML 1.2."""

from __future__ import annotations

import re
from typing import Any

import yaml

_TAG = "tag:yaml.org,2002:"
# YAML 1.1 takes 1:30 for 90, 010 for 8 and 2020-01-01 for a date, and does not take 1e-3 for a number.
_NUMBERS = {
    "int": r"[-+]?(0|[1-9][0-9]*)",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
}


class SceneLoader(yaml.SafeLoader):
    """To be used as `yaml.load(text, SceneLoader)`."""

    def compose_mapping_node(self, anchor: str | None) -> Any:
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            problem = None
            if key.tag not in (_TAG + "str", _TAG + "merge"):
                problem = "a key must be a text; put it in quotes"
            elif key.value in lines:
                problem = f"{key.value} is given twice, first in line {lines[key.value]}"
            if problem is not None:
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            lines[key.value] = key.start_mark.line + 1
        return node


SceneLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if tag.removeprefix(_TAG) not in (*_NUMBERS, "timestamp")]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _name, _pattern in _NUMBERS.items():
    SceneLoader.add_implicit_resolver(_TAG + _name, re.compile(f"(?:{_pattern})$"), list("-+.0123456789"))
