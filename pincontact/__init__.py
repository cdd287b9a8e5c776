"""Persistent point contacts for Pinocchio."""
