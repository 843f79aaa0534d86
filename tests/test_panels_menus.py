# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Menus, the key of the pie menu, and links to the documentation. tests/gui opens them in a window."""

from __future__ import annotations

import contextlib
import fnmatch
from pathlib import Path

import bpy
import pytest

from fipt_blender import operators
from fipt_blender.panels import manual, menus

pytestmark = pytest.mark.usefixtures("registered")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True)
def site(monkeypatch):
    address = manual.SITE or "https://docs.example/"
    monkeypatch.setattr(manual, "SITE", address)
    return address


def test_every_item_of_the_menus_is_an_operator():
    idnames = {operator.bl_idname for operator in operators.CLASSES if issubclass(operator, bpy.types.Operator)}
    listed = {f"fipt.{name}" for section in menus.SECTIONS.values() for name, _ in section}
    assert listed <= idnames


def test_each_section_has_a_chapter():
    for menu in menus.MENUS:
        chapter = manual.chapter_of(menu.bl_idname.replace("_MT_", "_PT_"))
        assert (ROOT / "docs" / "guide" / f"{chapter}.md").is_file()
        assert manual.chapter_page(chapter) == f"guide/{chapter}.html"
    assert manual.chapter_of("FIPT_PT_capture_alignment") == "capture" and manual.chapter_of("X") == ""
    assert chapter and manual.chapter_page("") == "guide/index.html"


def test_without_a_site_help_opens_the_pages_of_the_extension(monkeypatch, tmp_path):
    pages = tmp_path / "a folder"
    pages.mkdir()
    (pages / "index.html").touch()
    monkeypatch.setattr(manual, "SITE", "")
    monkeypatch.setattr(manual, "PAGES", pages)
    opened = []
    with _browser(opened):
        assert bpy.ops.fipt.help(chapter="lights") == {"FINISHED"}
        assert bpy.ops.fipt.help() == {"FINISHED"}
    assert opened == [f"{pages.as_uri()}/lights.html", f"{pages.as_uri()}/index.html"]
    assert opened[0].startswith("file:///") and " " not in opened[0]
    assert _found("bpy.ops.fipt.add_light") == f"{pages.as_uri()}/lights.html"
    assert _found("bpy.ops.fipt.cancel_setup") == f"{pages.as_uri()}/index.html"


@pytest.mark.parametrize(
    ("name", "page"),
    [
        ("bpy.ops.fipt.estimate", "operators.html"),
        ("bpy.types.FIPT_LightsSettings.blend", "guide/lights.html"),
        ("bpy.types.FIPT_Light.stops", "guide/lights.html"),
        ("bpy.types.FIPT_CaptureSettings.path", "guide/capture.html"),
    ],
)
def test_the_online_manual_finds_operators_and_properties(name, page):
    assert _found(name) == manual.SITE + page


def _found(name):
    """The address that Blender finds in our map."""
    site, pages = menus.online_manual()
    assert (site, pages) in bpy.utils.manual_map()
    return site + next(page for pattern, page in pages if fnmatch.fnmatchcase(name.lower(), pattern))


@contextlib.contextmanager
def _browser(opened):
    """Notes what Blender would open in the browser."""

    class Recorder(bpy.types.Operator):
        """Stands for the browser"""

        bl_idname = "wm.url_open"
        bl_label = "Open"
        url: bpy.props.StringProperty()

        def execute(self, context):
            opened.append(self.url)
            return {"FINISHED"}

    original = bpy.types.WM_OT_url_open
    bpy.utils.unregister_class(original)
    bpy.utils.register_class(Recorder)
    try:
        yield
    finally:
        bpy.utils.unregister_class(Recorder)
        bpy.utils.register_class(original)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The user's folder of presets."""

    def user_resource(kind: str, *, path: str = "", create: bool = False) -> str:
        place = tmp_path / path
        if create:
            place.mkdir(parents=True, exist_ok=True)
        return str(place)

    monkeypatch.setattr(bpy.utils, "user_resource", user_resource)
    return tmp_path / "presets"


def store(section: str, folder: Path) -> Path:
    operator = getattr(bpy.ops.fipt, f"add_{section}_preset")
    assert operator(name="Mine") == {"FINISHED"}
    return folder / "fipt" / section / "Mine.py"


def recall(path: Path, section: str) -> None:
    menu = f"FIPT_PT_{section}_presets"
    assert bpy.ops.script.execute_preset(filepath=str(path), menu_idname=menu) == {"FINISHED"}


def test_estimate_settings_come_back(folder):
    settings = bpy.context.scene.fipt.estimate
    settings.preset, settings.device = "high", "llvm"
    settings.diffuse_samples, settings.denoise = 77, False
    path = store("estimate", folder)
    settings.preset, settings.device = "draft", "auto"
    settings.reset()
    settings.rounds = 5
    recall(path, "estimate")
    assert (settings.preset, settings.device, settings.diffuse_samples) == ("high", "llvm", 77)
    assert not settings.denoise and not settings.is_changed("rounds")
