"""The story's chapter on meshes that do not share the cameras' coordinates: points picked by mouse."""

from __future__ import annotations

from typing import Any

import inside
from chapters import Options
from window import Window

_SIGHTS = (2, 2, 1)  # photographs in which each corner is clicked
_CORNERS = len(_SIGHTS)


def align(window: Window, options: Options) -> None:
    """Pick corners on the mesh and in one or two photographs each; align, remove, undo."""
    corners = [corner for corner in window.ask(inside.room_corners) if len(corner["views"]) >= 2]
    assert len(corners) >= _CORNERS, corners
    window.open_section("Capture", "Alignment", "Cameras to Mesh")
    window.point_in_view()
    if window.ask(inside.view_through):
        window.key("NUMPAD_0")
    window.key("HOME")  # all in the picture
    for number, corner in enumerate(corners[:_CORNERS]):
        _pick(window, corner, _SIGHTS[number], pictures=number == 0)
        window.wait(inside.pairs, until=lambda pairs, count=number + 1: pairs["count"] == count)
    found = window.ask(inside.pairs)
    assert found["sights"] == list(_SIGHTS) and 0.0 <= found["error"] < 0.05, found
    for picked, corner in zip(found["points"], corners, strict=False):
        assert max(abs(a - b) for a, b in zip(picked, corner["point"], strict=True)) < 1e-3, found  # snapped
    window.hover("fipt.align_by_pairs")
    window.shot("06_align_pairs")
    before = window.ask(inside.camera_places)
    window.click("fipt.align_by_pairs")
    after = window.wait(inside.camera_places, until=before.__ne__)
    moved = max(abs(a - b) for one, other in zip(before, after, strict=True) for a, b in zip(one, other, strict=True))
    assert moved < 0.2, moved  # they were right but for the pixels of the clicks
    fit = window.wait(inside.pairs, until=lambda pairs: 0.0 <= pairs["error"] <= found["error"] + 1e-3)
    window.click("fipt.look_through", step=1)
    window.shot("06_align_view")
    window.click("fipt.remove_pair", index=0)
    window.wait(inside.pairs, until=lambda pairs: pairs["count"] == _CORNERS - 1)
    window.point_in_view()
    window.key("ctrl+Z")
    window.wait(inside.pairs, until=lambda pairs: pairs["count"] == _CORNERS)
    window.click("fipt.pick_pair")
    window.point_in_view()
    window.key("ESC")
    assert window.ask(inside.pairs) == fit


def _pick(window: Window, corner: dict[str, Any], sights: int, pictures: bool) -> None:
    """Click a corner on the mesh, then in the photographs that are nearest in the list."""
    cameras = window.ask(inside.view_cameras)
    window.click("fipt.pick_pair")
    window.point_at(corner["aim"])
    window.settle()
    if pictures:
        window.shot("06_align_mesh")
    window.press()
    window.wait(inside.view_through, until=bool)
    views = list(corner["views"])
    for _ in range(sights):
        active = cameras.index(window.ask(inside.view_through))
        steps = min((_steps(active, view, len(cameras)) for view in views), key=abs)
        index = (active + steps) % len(cameras)
        views.remove(index)
        for _ in range(abs(steps)):
            window.key("PAGE_DOWN" if steps > 0 else "PAGE_UP")
        window.wait(inside.view_through, until=cameras[index].__eq__, seconds=60.0)
        window.point_at(corner["point"])
        window.settle()
        if pictures:
            window.shot("06_align_photograph")
        window.press()
    if sights < 2:
        window.key("RET")


def _steps(start: int, end: int, count: int) -> int:
    """The fewest steps from one row of a list to another; it begins anew after its end."""
    forward = (end - start) % count
    return forward if 2 * forward <= count else forward - count
