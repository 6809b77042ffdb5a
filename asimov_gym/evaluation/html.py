"""A document as one HTML file: styles and pictures inside, nothing loaded from elsewhere, no scripts."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from asimov_gym.evaluation.document import Block, Code, Facts, Folded, Heading, Picture, Text
from asimov_gym.evaluation.table import Table

_STYLE = """
:root { color-scheme: light dark; --ink: #1c1f23; --soft: #5b636d; --paper: #ffffff; --line: #d9dde2; --band: #f4f6f8;
  --good: #00694c; --bad: #a83c00; --note: #fff4d6; --note-ink: #5c4400; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8eb; --soft: #a2aab4; --paper: #15181c; --line: #363c44;
  --band: #1e2227; --good: #4fc59b; --bad: #ff9a5c; --note: #3a2f10; --note-ink: #ffe09a; } }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; color: var(--ink);
  background: var(--paper); max-width: 68rem; margin: 2rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .75rem; }
h2 { font-size: 1.25rem; margin: 2.25rem 0 .6rem; border-bottom: 1px solid var(--line); padding-bottom: .25rem; }
h3 { font-size: 1.02rem; margin: 1.5rem 0 .4rem; }
p { margin: .4rem 0 .8rem; }
.note { color: var(--soft); font-size: .9rem; }
.warning { background: var(--note); color: var(--note-ink); padding: .6rem .9rem; border-radius: .3rem;
  font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; margin: .3rem 0 1rem; }
th, td { text-align: left; vertical-align: top; padding: .28rem .75rem .28rem 0; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--soft); white-space: nowrap; }
tbody tr:hover { background: var(--band); }
td.good { color: var(--good); font-weight: 600; } td.bad { color: var(--bad); font-weight: 600; }
figure { margin: 1rem 0 1.75rem; break-inside: avoid; }
figure img { display: block; max-width: 100%; height: auto; background: #fff; border: 1px solid var(--line);
  border-radius: .3rem; padding: .4rem; }
figcaption { color: var(--soft); font-size: .88rem; margin-top: .4rem; max-width: 52rem; }
pre { background: var(--band); border: 1px solid var(--line); border-radius: .3rem; padding: .7rem .9rem;
  overflow-x: auto; font-size: .84rem; }
summary { cursor: pointer; font-weight: 600; margin: 1rem 0 .4rem; }
@media print {
  :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --line: #bbb; --band: #fff; --good: #00694c;
    --bad: #a83c00; --note: #fff; --note-ink: #000; }
  body { max-width: none; margin: 0; font-size: 10pt; } h2, h3 { break-after: avoid; } tr { break-inside: avoid; }
  .wide { overflow: visible; } details::details-content { content-visibility: visible; block-size: auto; }
}
"""
_GOOD, _BAD = frozenset({"met", "better", "passed"}), frozenset({"missed", "worse", "not passed"})
"""Cells that say so are marked by colour, beside the word."""


def to_html(title: str, blocks: Sequence[Block]) -> str:
    """The document as a page that needs no other file and no network.

    Args:
        title: heading of the page.
        blocks: its content; pictures are read from their files and put inside.

    Raises:
        FileNotFoundError: a picture's file is missing.
    """
    body = "\n".join(map(_html, blocks))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def _html(block: Block) -> str:
    match block:
        case Heading():
            return f"<h{block.level}>{_inline(block.text)}</h{block.level}>"
        case Text():
            return f'<p class="warning">{_inline(block.text)}</p>' if block.warning else f"<p>{_inline(block.text)}</p>"
        case Facts():
            rows = "".join(
                f'<tr><th scope="row">{_inline(name)}</th><td>{_inline(value)}</td></tr>' for name, value in block.rows
            )
            return f'<div class="wide"><table><tbody>{rows}</tbody></table></div>'
        case Picture():
            data = base64.b64encode(block.path.read_bytes()).decode("ascii")
            return (
                f"<figure><h3>{_inline(block.title)}</h3>"
                f'<img alt="{escape(block.title, quote=True)}" src="data:image/png;base64,{data}">'
                f"<figcaption>{_inline(block.caption)}</figcaption></figure>"
            )
        case Code():
            return f"<pre><code>{escape(block.text)}</code></pre>"
        case Folded():
            return f"<details><summary>{_inline(block.table.title)}</summary>{_rows(block.table)}</details>"
        case Table():
            return f"<h3>{_inline(block.title)}</h3>{_rows(block)}"


def _rows(table: Table) -> str:
    note = f'<p class="note">{_inline(table.note)}</p>' if table.note else ""
    head = "".join(f'<th scope="col">{_inline(column)}</th>' for column in table.columns)
    rows = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>\n" for row in table.rows)
    return f'{note}<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'


def _cell(text: str) -> str:
    mark = ' class="good"' if text in _GOOD else ' class="bad"' if text in _BAD else ""
    return f"<td{mark}>{_inline(text)}</td>"


def _inline(text: str) -> str:
    """Escaped text, with `code` in backquotes."""
    parts = escape(text).split("`")
    if len(parts) % 2 == 0:  # an odd backquote is one
        return escape(text)
    return "".join(f"<code>{part}</code>" if place % 2 else part for place, part in enumerate(parts))
