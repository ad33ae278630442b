"""The command lines ``train.py`` and ``evaluate.py``, which combine the jobs of ``agents``."""
