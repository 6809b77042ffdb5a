"""What a report is made of, and how it reads as Markdown; `html` draws the same as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from asimov_gym.evaluation.table import Table


@dataclass(frozen=True)
class Heading:
    """The beginning of a section."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    warning: bool = False
    """To be seen at once."""


@dataclass(frozen=True)
class Facts:
    """Names and values."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Picture:
    """A PNG file with what it shows."""

    path: Path
    title: str
    caption: str


@dataclass(frozen=True)
class Code:
    """Lines to be typed, or the output of a program."""

    text: str


@dataclass(frozen=True)
class Folded:
    """A long table that opens on a click; in Markdown and on paper it is open."""

    table: Table


Block = Heading | Text | Facts | Picture | Code | Folded | Table


def to_markdown(title: str, blocks: Sequence[Block]) -> str:
    """The document as Markdown; pictures by file name, so it belongs into their folder."""
    return "\n\n".join([f"# {title}", *map(_markdown, blocks)]) + "\n"


def _markdown(block: Block) -> str:
    match block:
        case Heading():
            return f"{'#' * block.level} {block.text}"
        case Text():
            return f"**{block.text}**" if block.warning else block.text
        case Facts():
            return Table("", ("", ""), block.rows).markdown_rows()
        case Picture():
            return f"### {block.title}\n\n![{block.title}]({block.path.name})\n\n{block.caption}"
        case Code():
            return f"```\n{block.text}\n```"
        case Folded():
            return block.table.markdown()
        case Table():
            return block.markdown()
