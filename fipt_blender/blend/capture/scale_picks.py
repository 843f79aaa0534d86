"""Two points of a known distance, picked in merged photographs: the image shown, the setting's text."""

from __future__ import annotations

import bpy

from ...prepare.preparation import Group, PreparationFolder


def with_picks(before: str, view: str, first: tuple[float, ...], second: tuple[float, ...]) -> str:
    """The text of the setting `scale_picks` with both points in one more view; an earlier pick there goes."""
    kept = [point.split(",") for point in before.split(";")] if before.count(";") == 1 else [[], []]
    parts = []
    for picks, (x, y) in zip(kept, (first, second), strict=True):
        others = [pick.strip() for pick in picks if pick.strip() and pick.split()[:-2] != view.split()]
        parts.append(", ".join([*others, f"{view} {x:.1f} {y:.1f}"]))
    return "; ".join(parts)


def shown_group(space: bpy.types.Space | None, settings: bpy.types.PropertyGroup) -> str:
    """The name of the group whose merged image an Image Editor shows, "" for another image."""
    image = space.image if space is not None and space.type == "IMAGE_EDITOR" else None
    folder = settings.capture_folder()
    if image is None or folder is None:
        return ""
    path = bpy.path.abspath(image.filepath)
    names = (group.name for group in settings.groups)
    return next((name for name in names if path == str(PreparationFolder(folder).image(Group(name, ())))), "")
