"""The story's chapter on the materials of parts: the list, picking, adjusting and selecting faces."""

from __future__ import annotations

import inside
from chapters import Options
from window import Window

_LIST = ("Materials", "Materials of Parts")


def part_materials(window: Window, options: Options) -> None:
    """Pick a part in the viewport, adjust it, select its faces, mark it as an asset."""
    window.open_section("Capture", "Views")
    window.click_row("capture.active_view", 1)
    window.open_section(*_LIST)
    found = window.ask(inside.part_rows)
    assert len(found["names"]) > 3 and len(set(found["names"])) == len(found["names"]), found
    window.shot("20_parts_list")
    window.click_row("materials.active_part", 2)  # the ceiling, which this view does not show
    found = window.ask(inside.part_rows)
    window.click("fipt.pick_part")
    window.point_in_view(0.35, 0.8)
    window.settle()
    window.press()
    picked = window.wait(inside.part_rows, until=lambda now: now["active"] != found["active"])
    window.settle()
    window.shot("21_part_picked")
    active = f"materials.parts[{picked['names'].index(picked['active'])}]"
    window.set_text(f"{active}.roughness_value", "0.3")
    window.open_section(*_LIST, "More")
    window.set_text(f"{active}.hue", "0.3")
    adjusted = window.wait(inside.part_rows, until=lambda now: abs(now["roughness_value"] - 0.3) < 1e-4)
    assert abs(adjusted["hue"] - 0.3) < 1e-4, adjusted
    window.shot("22_part_adjusted")
    window.open_section("Materials")
    window.choose("materials.shown", "BASE_COLOR")
    window.settle(5.0)
    window.shot("22_part_base_color")
    window.choose("materials.shown", "ESTIMATED")
    window.open_section(*_LIST, "More")
    window.click("fipt.select_part_faces")
    window.wait(inside.part_rows, until=lambda now: now["mode"] == "EDIT_MESH")
    window.settle()
    window.shot("23_part_faces")
    window.point_in_view(0.5, 0.5)
    window.key("TAB")
    window.wait(inside.part_rows, until=lambda now: now["mode"] == "OBJECT")
    window.open_section(*_LIST, "More")
    window.click("fipt.mark_part_assets", all_parts=False)
    window.wait(inside.part_rows, until=lambda now: now["assets"] > 0)
    window.click("fipt.reset_part", all_parts=False)
    window.wait(inside.part_rows, until=lambda now: now["roughness"] == 0.0)
    window.shot("24_part_reset")
