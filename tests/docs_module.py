"""The modules that make pages of the docs, for tests: they lie beside the pages, not in a package."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parent.parent / "docs"


def docs_module(name: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """One of them; for fixtures to yield from. It and what it imports there are forgotten afterwards."""
    monkeypatch.syspath_prepend(str(DOCS))
    yield importlib.import_module(name)
    for path in DOCS.glob("*.py"):
        sys.modules.pop(path.stem, None)
