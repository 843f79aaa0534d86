"""Menus, the key of the pie menu, and links to the documentation. tests/gui opens them in a window."""

from __future__ import annotations

import fnmatch
import webbrowser
from pathlib import Path

import bpy
import pytest

from fipt_blender.operators import menus
from fipt_blender.panels import manual

pytestmark = pytest.mark.usefixtures("registered")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True)
def site(monkeypatch):
    address = manual.SITE or "https://docs.example/"
    monkeypatch.setattr(manual, "SITE", address)
    return address


def test_each_operator_of_a_section_is_in_its_menu_and_has_a_chapter():
    listed = {name for modules in menus.CHAPTERS.values() for name in menus.operators_of(modules)}
    assert {"fipt.estimate", "fipt.collect_room", "fipt.set_up_engine"} <= listed
    assert listed.isdisjoint({"fipt.notice", "fipt.delete_version"})  # without an argument these do nothing
    for chapter in menus.CHAPTERS:
        assert (ROOT / "docs" / "guide" / f"{chapter}.md").is_file()


def test_without_a_site_help_opens_the_pages_of_the_extension(monkeypatch, tmp_path):
    pages = tmp_path / "a folder"
    pages.mkdir()
    (pages / "index.html").touch()
    monkeypatch.setattr(manual, "SITE", "")
    monkeypatch.setattr(manual, "PAGES", pages)
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert bpy.ops.fipt.help() == {"FINISHED"}
    assert opened == [f"{pages.as_uri()}/index.html"]
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


def test_estimate_settings_come_back(tmp_path, monkeypatch):
    def user_resource(kind: str, *, path: str = "", create: bool = False) -> str:
        (tmp_path / path).mkdir(parents=True, exist_ok=True)
        return str(tmp_path / path)

    monkeypatch.setattr(bpy.utils, "user_resource", user_resource)
    settings = bpy.context.scene.fipt.estimate
    settings.preset, settings.device = "high", "llvm"
    settings.diffuse_samples, settings.denoise = 77, False
    assert bpy.ops.fipt.add_estimate_preset(name="Mine") == {"FINISHED"}
    settings.preset, settings.device = "draft", "auto"
    settings.reset()
    settings.rounds = 5
    path = tmp_path / "presets" / "fipt" / "estimate" / "Mine.py"
    recalled = bpy.ops.script.execute_preset(filepath=str(path), menu_idname="FIPT_PT_estimate_presets")
    assert recalled == {"FINISHED"}
    assert (settings.preset, settings.device, settings.diffuse_samples) == ("high", "llvm", 77)
    assert not settings.denoise and not settings.is_changed("rounds")
