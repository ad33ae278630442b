"""Embedded motions, made from a few parameters."""
