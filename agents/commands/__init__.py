"""The command lines ``train.py`` and ``evaluate.py``, which put the jobs of ``agents`` together."""
