"""python offline.py FOLDER: the guide as plain HTML pages for the extension's zip, without a connection."""

from __future__ import annotations

import html
import re
import shutil
import sys
from pathlib import Path
from xml.etree.ElementTree import Element

import markdown
from markdown.treeprocessors import Treeprocessor

DOCS = Path(__file__).resolve().parents[1]
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


class _LocalLinks(Treeprocessor):
    """Pages and pictures lie in one folder; links to pages that are not there become their text alone."""

    def run(self, root: Element) -> None:
        for link in root.iter("a"):
            page, _, place = link.get("href", "").partition("#")
            name = page.rpartition("/")[2].removesuffix(".md")
            if name in _sources() and page:
                link.set("href", f"{name}.html{'#' + place if place else ''}")
            elif page and not page.startswith(("http://", "https://")):
                link.tag = "span"
                link.attrib.clear()
        for picture in root.iter("img"):
            picture.set("src", picture.get("src", "").removeprefix("../"))


def _sources() -> dict[str, Path]:
    """The Markdown files by the names of their pages."""
    return {path.stem: path for path in (*sorted((DOCS / "guide").glob("*.md")), DOCS / "capture_formats.md")}


def write_pages(folder: Path) -> None:
    """Write the guide's pages, that of the capture formats, and the pictures."""
    for name, source in _sources().items():
        text = source.read_text(encoding="utf-8")
        reader = markdown.Markdown(extensions=["tables", "fenced_code", "toc"], output_format="html")
        reader.treeprocessors.register(_LocalLinks(reader), "local_links", 0)
        body = reader.convert(text)
        if name != "index":
            body = f'<p><a href="index.html">Guide</a></p>\n{body}'
        _write(folder / f"{name}.html", reader.toc_tokens[0]["name"], body)
        for picture in re.findall(r"\]\((?:\.\./)?(images/[^)]+)\)", text):
            (folder / picture).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(DOCS / picture, folder / picture)


def _write(path: Path, title: str, body: str) -> None:
    page = (
        f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n{body}\n</body>\n</html>\n"
    )
    path.write_text(page, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
