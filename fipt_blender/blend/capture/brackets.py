"""The list of groups in the scene, filled from prepare.json and read back, and the outcome for each group."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import PurePath

import bpy

from ...prepare.facts import MergeFacts, SolveFacts, read_facts, shutter_text
from ...prepare.preparation import Group, Photograph, PreparationFolder, read_preparation


def list_groups(settings: bpy.types.PropertyGroup, folder: PreparationFolder) -> None:
    """Fill the list from prepare.json, and each group's outcome from the steps that have run."""
    preparation = read_preparation(folder)
    exposures = {photograph.path: exposure_text(photograph) for photograph in preparation.photographs}
    fill(settings, preparation.groups, exposures)
    settings.listed = digest(preparation.groups)
    show_outcome(settings, read_facts(folder, "merge", MergeFacts), read_facts(folder, "solve", SolveFacts))


def fill(settings: bpy.types.PropertyGroup, groups: Sequence[Group], exposures: Mapping[str, str]) -> None:
    """Replace the list by these groups; `exposures` has a text for each path."""
    settings.groups.clear()
    for group in groups:
        item = settings.groups.add()
        item.name, item.used = group.name, group.used
        for path in group.photographs:
            photograph = item.photographs.add()
            photograph.name, photograph.exposure = path, exposures.get(path, "")
    settings.active_group = min(settings.active_group, max(len(groups) - 1, 0))
    settings.registered_count = -1


def listed_groups(settings: bpy.types.PropertyGroup) -> list[Group]:
    """The groups as the list shows them."""
    return [
        Group(group.name, tuple(photograph.name for photograph in group.photographs), group.used)
        for group in settings.groups
    ]


def listed_exposures(settings: bpy.types.PropertyGroup) -> dict[str, str]:
    """The text beside each photograph in the list, by its path."""
    return {
        photograph.name: photograph.exposure for group in settings.groups for photograph in group.photographs
    }


def digest(groups: Sequence[Group]) -> str:
    """A short text that differs for different groups."""
    content = json.dumps([[group.name, group.used, *group.photographs] for group in groups])
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def tick_chosen(settings: bpy.types.PropertyGroup) -> None:
    """If single files were chosen, tick only the groups that hold one of them."""
    chosen = set(settings.chosen.splitlines())
    if chosen:
        for group in settings.groups:
            group.used = any(PurePath(item.name).name in chosen for item in group.photographs)


def show_outcome(
    settings: bpy.types.PropertyGroup, merge: MergeFacts | None, solve: SolveFacts | None
) -> None:
    """Note in the list what merging and solving have found out of each group."""
    clipped = {image.name: image.clipped_share or 0.0 for image in (merge.images if merge else ())}
    registered = {view.name for view in (solve.registered if solve else ())}
    left_out = {view.name: view.reason for view in (solve.left_out if solve else ())}
    for group in settings.groups:
        group.clipped_share = clipped.get(group.name, 0.0)
        group.problem = left_out.get(group.name, "")
        group.state = (
            "REGISTERED" if group.name in registered else "LEFT_OUT" if group.name in left_out else "NONE"
        )
    settings.registered_count = len(registered) if solve else -1


def exposure_text(photograph: Photograph) -> str:
    """Shutter, aperture and ISO as cameras show them, e.g. "1/60 s  f/8  ISO 100"."""
    parts = []
    if photograph.shutter:
        parts.append(shutter_text(photograph.shutter))
    if photograph.aperture:
        parts.append(f"f/{photograph.aperture:g}")
    if photograph.iso:
        parts.append(f"ISO {photograph.iso:g}")
    return "  ".join(parts)
