"""Benchmarks, as ratios within one run; ``docs/performance.md`` holds the results."""
