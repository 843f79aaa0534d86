# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation site is built without a warning, and has all operators."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import zipfile
from html.parser import HTMLParser
from pathlib import Path

import bpy

from fipt_blender import operators
from fipt_blender.panels import manual

ROOT = Path(__file__).resolve().parent.parent


class Text(HTMLParser):
    """The text of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_site_is_complete(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stderr
    pages = {path.stem for path in tmp_path.glob("*.html")}
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} <= pages
    page = Text()
    page.feed((tmp_path / "operators.html").read_text(encoding="utf-8"))
    for each in operators.CLASSES:
        if issubclass(each, bpy.types.Operator):
            internal = "INTERNAL" in getattr(each, "bl_options", ())
            assert (f"bpy.ops.{each.bl_idname}\n" in page.text) != internal, each.bl_idname
    assert not list(tmp_path.rglob("*.py")), "hooks are no pages"


class Pages(HTMLParser):
    """What a page refers to, its anchors, and whether all its elements are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)
        values = dict(attributes)
        self.anchors.add(values.get("id") or "")
        self.targets += [values[name] or "" for name in ("href", "src") if name in values]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def _read(content: bytes) -> Pages:
    page = Pages()
    page.feed(content.decode())
    page.close()
    assert not page.open
    return page


def test_the_guide_in_the_zip_is_complete(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("dev", ROOT / "dev.py")
    dev = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(dev)
    with zipfile.ZipFile(dev.build_extension(tmp_path)) as archive:
        names = {name.removeprefix("guide/") for name in archive.namelist() if name.startswith("guide/")}
        pages = {name: _read(archive.read(f"guide/{name}")) for name in names if name.endswith(".html")}
    for name, page in pages.items():
        for target in page.targets:
            if not target.startswith("https://"):
                file, _, place = target.partition("#")
                assert (file or name) in names, (name, target)
                assert not place or place in pages[file or name].anchors, (name, target)
    assert {f"{manual.chapter_of(panel)}.html" for panel in ("FIPT_PT_lights", "FIPT_PT_check")} <= names
    assert "install.html" in names
    assert pages["lights.html"].targets == ["guide.html#lights"]
    shown = " ".join(pages["guide.html"].text.split())
    guide = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8").partition("```")[0]
    guide = re.sub(r"<a [^>]*></a>|!\[[^]]*\]\([^)]*\)|^\|[-|]+\|$", "", guide, flags=re.MULTILINE)
    guide = re.sub(r"^#+ |^ *(-|\d\.) |[*`]", "", guide, flags=re.MULTILINE)
    guide = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", guide)
    for words in re.split(r"[|\n]", guide):
        assert " ".join(words.split()) in shown
    assert "**" not in shown and "](" not in shown and "|" not in shown
