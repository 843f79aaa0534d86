# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The story's chapter on the materials of parts: the list, and picking a part in the viewport."""

from __future__ import annotations

from chapters import Options, finish
from window import Window

_LIST = ("Materials", "Materials of Parts")


def part_materials(window: Window, options: Options) -> None:
    """Apply again, and pick a part in the viewport."""
    window.open_section("Materials")
    window.click("fipt.apply_results")
    finish(window, "materials")
    window.open_section("Capture")
    window.click_row("capture.active_view", 1)
    window.open_section(*_LIST)
    found = window.ask("inside.part_rows")
    assert len(found["names"]) > 3 and len(set(found["names"])) == len(found["names"]), found
    window.shot("20_parts_list")
    window.click("fipt.pick_part")
    window.point_in_view(0.35, 0.8)
    window.settle()
    window.press()
    window.wait("inside.part_rows", until=lambda now: now["active"] != found["active"])
    window.settle()
    window.shot("21_part_picked")
