"""Synthetic motion generated from a few parameters."""
