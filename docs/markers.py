"""What the pages are put together with: tables, wrapped prose, and pages written by hand but for marked parts."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

Table = Callable[[Sequence[str], Iterable[Sequence[object]]], str]
"""Writes a Markdown table from its header and rows."""


def filled(page: Path, made: Mapping[str, str]) -> str:
    """The page with its made parts as they are now.

    Args:
        page: Markdown file; a part stands between `<!-- NAME: made by docs/generate.py -->` and `<!-- end of NAME -->`.
        made: parts by name.

    Raises:
        ValueError: a marker on the page has no part, or a part no marker.
    """
    text = page.read_text(encoding="utf-8")
    marked = re.findall(r"<!-- (\w+): made by docs/generate\.py -->\n", text)
    if sorted(marked) != sorted(made):
        raise ValueError(f"{page.name} has markers for {sorted(marked)}, its tables are {sorted(made)}")
    for name, body in made.items():
        begin, end = f"<!-- {name}: made by docs/generate.py -->\n", f"<!-- end of {name} -->\n"
        head, _, rest = text.partition(begin)
        _, found, tail = rest.partition(end)
        if not found:
            raise ValueError(f"{page.name} lacks the line {end.strip()!r}")
        text = head + begin + body + end + tail
    return text


def prose(text: str, indent: str = "") -> str:
    """A paragraph in lines that are not too long; `indent` is that of all lines but the first."""
    return textwrap.fill(
        " ".join(text.split()), 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
