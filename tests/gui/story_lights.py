"""The story's chapters on lights and seeing: aiming, EEVEE, menus."""

from __future__ import annotations

import bpy
import inside
from chapters import Options
from hand import VIEW
from window import Window


def named(window: Window, options: Options) -> None:
    """Select a lamp, which has a name that says where it is."""
    window.open_section("Capture", "Views")
    window.click_row("capture.active_view", 1)
    window.open_section("Lights")
    rows = window.ask(inside.light_rows)
    names = [row["name"] for row in rows]
    assert not any(name.startswith("Fixture") for name in names), names
    window.shot("30_lights_named")
    window.click_row("lights.active", 0)
    window.click("fipt.select_light")
    window.settle()
    window.shot("30_lights")


def menus(window: Window, options: Options) -> None:
    """The pie menu on its key, the menu search, and the shortcut in the preferences."""
    window.point_in_view(0.45, 0.5)
    window.event("F", "PRESS", shift=True, alt=True)  # which holds the menu open
    window.settle()
    window.shot("33_pie")
    window.event("F", "RELEASE", shift=True, alt=True)
    window.key("ESC")
    window.point_in_view(0.45, 0.5)
    window.search("Exposure from Photographs")
    window.shot("33_searched")


def aim(window: Window, options: Options) -> None:
    """Drag the end of a new light's beam over the room."""
    window.open_section("Lights")
    window.click("fipt.add_light", place="PICK")
    window.point_in_view(0.45, 0.4)
    window.settle()
    window.press()
    window.wait(inside.light_rows, until=lambda now: now[-1]["kind"] == "LIGHT")
    window.settle()
    before = window.ask(inside.beam)
    window.shot("34_light_to_aim")
    _drag(window, before["pixel"], (90, 40))
    window.wait(inside.beam, until=lambda now: now["turn"] != before["turn"])
    window.settle()
    window.shot("34_light_aimed")
    window.point_in_view(0.9, 0.9)
    window.key("ctrl+Z")
    window.wait(inside.beam, until=lambda now: now["turn"] == before["turn"])


def eevee(window: Window, options: Options) -> None:
    """Set the room up for EEVEE and look at it."""
    window.open_section("Lights", "Scene and Passes")
    window.click("fipt.prepare_eevee")
    window.wait(lambda: "EEVEE" in bpy.context.scene.render.engine)
    window.wait(lambda: any(item.type == "LIGHT_PROBE" for item in bpy.context.scene.objects))
    window.settle(30.0)  # Blender shows the progress of the bake
    window.shot("35_eevee_set_up")


def _drag(window: Window, place: tuple[int, int], by: tuple[int, int]) -> None:
    """Drag with the left button from a place of the 3D viewport, in pixels of its region."""
    window.point(VIEW, *place)
    x, y = window.pointer
    window.settle()
    window.event("LEFTMOUSE", "PRESS")
    for step in range(1, 9):
        window.move(x + by[0] * step // 8, y + by[1] * step // 8)
        window.settle()
    window.event("LEFTMOUSE", "RELEASE")
    window.settle()
