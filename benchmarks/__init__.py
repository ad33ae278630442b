"""Measurements, as ratios within one run; ``docs/performance.md`` holds what they printed."""
