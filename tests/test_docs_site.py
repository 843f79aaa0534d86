# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation site is built without a warning, and has all operators."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import bpy

from fipt_blender import operators
from fipt_blender.panels import manual
from samples.child_processes import PATIENCE_SECONDS
from samples.development import load_dev
from samples.pages import Page

ROOT = Path(__file__).resolve().parent.parent


def test_the_site_is_complete(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_SECONDS)
    assert built.returncode == 0, built.stderr
    pages = {path.relative_to(tmp_path).with_suffix("") for path in tmp_path.rglob("*.html")}
    docs = ROOT / "docs"
    assert {path.relative_to(docs).with_suffix("") for path in docs.rglob("*.md")} <= pages
    page = Page(tmp_path / "operators.html")
    for each in operators.CLASSES:
        if issubclass(each, bpy.types.Operator):
            internal = "INTERNAL" in getattr(each, "bl_options", ())
            assert (f"bpy.ops.{each.bl_idname}\n" in page.text) != internal, each.bl_idname
    assert not list(tmp_path.rglob("*.py")), "hooks are no pages"


def test_the_guide_in_the_zip_is_complete(tmp_path: Path) -> None:
    with zipfile.ZipFile(load_dev().build_extension(tmp_path)) as archive:
        names = {name.removeprefix("guide/") for name in archive.namelist() if name.startswith("guide/")}
        pages = {name: Page(archive.read(f"guide/{name}")) for name in names if name.endswith(".html")}
    for name, page in pages.items():
        assert page.in_order and not page.open
        for target in page.values("href", "src"):
            if not target.startswith("https://"):
                file, _, place = target.partition("#")
                assert (file or name) in names, (name, target)
                assert not place or place in pages[file or name].values("id"), (name, target)
    assert {f"{manual.chapter_of(panel)}.html" for panel in ("FIPT_PT_lights", "FIPT_PT_check")} <= names
    assert "install.html" in names
    for path in (ROOT / "docs" / "guide").glob("*.md"):
        shown = " ".join(pages[f"{path.stem}.html"].text.split())
        guide = path.read_text(encoding="utf-8").partition("```")[0]
        guide = re.sub(r"!\[[^]]*\]\([^)]*\)|^\|[-|]+\|$", "", guide, flags=re.MULTILINE)
        guide = re.sub(r"^#+ |^ *(-|\d\.) |[*`]", "", guide, flags=re.MULTILINE)
        guide = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", guide)
        for words in re.split(r"[|\n]", guide):
            assert " ".join(words.split()) in shown
        assert "**" not in shown and "](" not in shown and "|" not in shown
