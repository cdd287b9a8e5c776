"""Optional packages, which are imported where they are first used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import MissingExtraError


def required(module: str, what: str, install: str) -> Any:
    """The module, or MissingExtraError; what: "plots need matplotlib"; install: what pip installs it by."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(f"{what}: pip install {install} ({error})") from error
