# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation site is built without a warning, and has all operators."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import bpy

from fipt_blender import operators

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
    for module in operators.MODULES:
        for each in module.CLASSES:
            if issubclass(each, bpy.types.Operator):
                internal = "INTERNAL" in getattr(each, "bl_options", ())
                assert (f"bpy.ops.{each.bl_idname}\n" in page.text) != internal, each.bl_idname
    assert not list(tmp_path.rglob("*.py")), "hooks are no pages"
