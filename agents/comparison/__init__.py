"""Compare all systems on the same frames: tables, figures, films, ablations."""
