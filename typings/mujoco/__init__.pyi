# MuJoCo's names live in compiled modules without stubs, so a type checker sees none of them. To it they are all Any.
from typing import Any

def __getattr__(name: str) -> Any: ...
