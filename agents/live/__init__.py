"""Simulations to watch while they run: the demo, and policies while they learn."""
