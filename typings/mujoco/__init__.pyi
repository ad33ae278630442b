"""MuJoCo's compiled modules come without types: every name of theirs is Any to pyright."""

from typing import Any

def __getattr__(name: str) -> Any: ...
