# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
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
PAGES = ("guide", "capture_formats")
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
    """Links lead to the pages of `PAGES`; those to other pages become their text alone."""

    def run(self, root: Element) -> None:
        for link in root.iter("a"):
            page, _, place = link.get("href", "").partition("#")
            name = page.removesuffix(".md")
            if name in PAGES:
                link.set("href", f"{name}.html{'#' + place if place else ''}")
            elif page and not page.startswith(("http://", "https://")):
                link.tag = "span"
                link.attrib.clear()


def write_pages(folder: Path) -> None:
    """Write the pages, one that leads to each chapter of the guide, and the pictures.

    A browser that is started with a file often loses the part of the address behind "#"; therefore each
    chapter has a small page that leads to its place.
    """
    for name in PAGES:
        text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
        reader = markdown.Markdown(extensions=["tables", "fenced_code", "toc"], output_format="html")
        reader.treeprocessors.register(_LocalLinks(reader), "local_links", 0)
        body = reader.convert(text)
        title = reader.toc_tokens[0]["name"]
        chapters = reader.toc_tokens[0]["children"]
        contents = " · ".join(f'<a href="#{each["id"]}">{each["name"]}</a>' for each in chapters)
        _write(folder / f"{name}.html", title, body.replace("</h1>", f"</h1>\n<p>{contents}</p>", 1))
        for picture in re.findall(r"\]\((images/[^)]+)\)", text):
            (folder / picture).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(DOCS / picture, folder / picture)
    for chapter in re.findall(r'<a id="([a-z-]+)"></a>', (DOCS / "guide.md").read_text(encoding="utf-8")):
        place = f"guide.html#{chapter}"
        refresh = f'<meta http-equiv="refresh" content="0; url={place}">'
        _write(folder / f"{chapter}.html", "Guide", f'<a href="{place}">Guide</a>', refresh)


def _write(path: Path, title: str, body: str, head: str = "") -> None:
    page = (
        f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"{head}<style>{_STYLE}</style></head>\n<body>\n{body}\n</body>\n</html>\n"
    )
    path.write_text(page, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
