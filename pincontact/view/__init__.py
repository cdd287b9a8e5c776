"""Replay in Meshcat, pages that stand alone, and plots. Neither meshcat nor matplotlib is imported until used."""

from .replay import export_html, replay

__all__ = ["export_html", "replay"]
