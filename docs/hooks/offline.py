# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The guide as plain HTML pages for the extension's zip, so that help needs no connection.

Standard library only, as `dev.py build` is. It reads the part of Markdown that the guide is written in:
headings, paragraphs, lists, tables, fenced code, anchors, pictures, links, bold, italic and code.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterator
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
PAGES = ("guide", "capture_formats")
FOLDER = "guide"  # in the zip
_STYLE = """
body { max-width: 50em; margin: 2em auto; padding: 0 1em; font: 16px/1.5 system-ui, sans-serif }
body { color: #222; background: #fff }
img { max-width: 100%; border: 1px solid #ccc }
table { border-collapse: collapse }
td, th { border: 1px solid #ccc; padding: .3em .6em; text-align: left; vertical-align: top }
pre, code { background: #f2f2f2; font-size: .9em } pre { padding: .8em; overflow: auto }
h2 { margin-top: 2em; border-bottom: 1px solid #ccc }
@media (prefers-color-scheme: dark) {
  body { color: #ddd; background: #1d1d1d } a { color: #7ab4ff } pre, code { background: #2b2b2b }
}
"""
_ANCHOR = re.compile(r'<a id="([a-z-]+)"></a>')
_ITEM = re.compile(r"( *)([-*]|\d+\.) +(.*)")
_FENCE = "```"


def offline_pages() -> dict[str, bytes]:
    """The files of the folder `FOLDER`: its pages, one that leads to each chapter, and the pictures.

    A browser that is started with a file often loses the part of the address behind "#"; therefore each
    chapter has a small page that leads to its place.
    """
    files: dict[str, bytes] = {}
    for name in PAGES:
        text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
        heading, _, rest = text.partition("\n")
        title = heading.lstrip("# ")
        body = [f"<h1>{_inline(title)}</h1>", _contents(rest), *_blocks(rest.splitlines())]
        files[f"{name}.html"] = _document(title, "\n".join(body)).encode()
        for picture in re.findall(r"\]\((images/[^)]+)\)", text):
            files[picture] = (DOCS / picture).read_bytes()
    for chapter in _ANCHOR.findall((DOCS / "guide.md").read_text(encoding="utf-8")):
        place = f"guide.html#{chapter}"
        refresh = f'<meta http-equiv="refresh" content="0; url={place}">'
        files[f"{chapter}.html"] = _document("Guide", f'<a href="{place}">Guide</a>', refresh).encode()
    return {f"{FOLDER}/{name}": content for name, content in files.items()}


def _document(title: str, body: str, head: str = "") -> str:
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"{head}<style>{_STYLE}</style></head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _contents(text: str) -> str:
    """Links to the chapters."""
    headings = [line.removeprefix("## ") for line in text.splitlines() if line.startswith("## ")]
    return " · ".join(f'<a href="#{_slug(heading)}">{_inline(heading)}</a>' for heading in headings)


def _blocks(lines: list[str]) -> Iterator[str]:
    """HTML of the lines of a document or of an item of a list."""
    at = 0
    while at < len(lines):
        line, start = lines[at], at
        if line.startswith(_FENCE):
            at = next(n for n in range(at + 1, len(lines)) if lines[n].startswith(_FENCE)) + 1
            yield f"<pre><code>{html.escape(chr(10).join(lines[start + 1 : at - 1]))}</code></pre>"
        elif line.startswith("|"):
            at = _end(lines, at, lambda text: text.startswith("|"))
            yield _table(lines[start:at])
        elif _ITEM.match(line):
            at = _end(lines, at, lambda text: bool(_ITEM.match(text)) or text.startswith(" ") or not text)
            yield from _list(lines[start:at])
        elif line.startswith("#"):
            at += 1
            level = len(line) - len(line.lstrip("#"))
            text = line[level:].strip()
            yield f'<h{level} id="{_slug(text)}">{_inline(text)}</h{level}>'
        elif not line.strip() or _ANCHOR.fullmatch(line.strip()):
            at += 1
            yield line.strip()
        else:
            at = _end(lines, at, lambda text: bool(text.strip()) and not _begins_block(text))
            yield f"<p>{_inline(' '.join(text.strip() for text in lines[start:at]))}</p>"


def _begins_block(line: str) -> bool:
    return line.startswith((_FENCE, "|", "#")) or bool(_ITEM.match(line))


def _end(lines: list[str], at: int, belongs: Callable[[str], bool]) -> int:
    """Index behind the lines from `at` on that belong to a block; its first line always does."""
    return next((n for n in range(at + 1, len(lines)) if not belongs(lines[n])), len(lines))


def _list(lines: list[str]) -> Iterator[str]:
    """HTML of a list, whose items are indented documents."""
    first = _ITEM.match(lines[0])
    assert first is not None
    indent, ordered = len(first[1]), first[2] not in "-*"
    items: list[list[str]] = []
    for line in lines:
        found = _ITEM.match(line)
        if found and len(found[1]) == indent:
            items.append([found[3]])
        else:
            items[-1].append(line)
    yield "<ol>" if ordered else "<ul>"
    for item in items:
        rest = [line for line in item[1:] if line.strip()]
        depth = min((len(line) - len(line.lstrip()) for line in rest), default=0)
        blocks = list(_blocks([item[0], *(line[depth:] for line in item[1:])]))
        shown = "\n".join(block for block in blocks if block)
        if shown.startswith("<p>"):
            shown = shown.removeprefix("<p>").replace("</p>", "", 1)
        yield f"<li>{shown}</li>"
    yield "</ol>" if ordered else "</ul>"


def _table(lines: list[str]) -> str:
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    head, body = rows[0], rows[2:]
    parts = ["<table>", _row(head, "th"), *(_row(row, "td") for row in body), "</table>"]
    return "\n".join(parts)


def _row(cells: list[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in cells) + "</tr>"


def _inline(text: str) -> str:
    """HTML of a line's text."""
    pieces = re.split(r"(`[^`]+`)", text)
    return "".join(
        f"<code>{html.escape(piece[1:-1])}</code>" if piece.startswith("`") else _marked(html.escape(piece))
        for piece in pieces
    )


def _marked(text: str) -> str:
    """Pictures, links, bold and italic; links to pages that are not here are their text alone."""
    text = re.sub(r"!\[([^\]]*)\]\(([^)]+)\)", r'<img src="\2" alt="\1">', text)
    text = re.sub(r"\[([^\]]*)\]\(([^)]+)\)", _link, text)
    text = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", text)
    return re.sub(r"\*(.+?)\*", r"<i>\1</i>", text)


def _link(found: re.Match[str]) -> str:
    text, target = found[1], found[2]
    page, _, place = target.partition("#")
    if page.startswith(("http://", "https://")) or not page:
        return f'<a href="{target}">{text}</a>'
    name = page.removesuffix(".md")
    if name not in PAGES:
        return text
    return f'<a href="{name}.html{"#" + place if place else ""}">{text}</a>'


def _slug(text: str) -> str:
    """A heading's anchor, as the site's."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", text.lower())).strip("-")
