# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the documentation site explains panels, operators and properties. Only a click opens it."""

from __future__ import annotations

# Address of the documentation site (dev.py docs makes it), with a slash at the end; empty as long as it is on
# no server: then nothing links to it. If it is set, blender_manifest.toml needs it as website, too.
SITE = ""

# Chapters of the guide, by the word after "FIPT_PT_" in the names of panels.
_CHAPTERS = ("photographs", "capture", "parts", "estimate", "materials", "lights", "insert", "check")


def chapter_of(panel: str) -> str:
    """The guide's chapter on a section, by its panel: "FIPT_PT_capture_alignment" is "capture"."""
    words = panel.split("_")
    return words[2] if len(words) > 2 and words[2] in _CHAPTERS else ""


def chapter_url(chapter: str) -> str:
    """Address of a chapter of the guide; of the guide itself for ""."""
    return f"{SITE}guide.html#{chapter}" if chapter else f"{SITE}guide.html"


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """For Blender's *Online Manual* in context menus: operators, and each section's properties.

    Without a site, nothing is found.
    """
    if not SITE:
        return "", ()
    sections = tuple((f"bpy.types.fipt_{chapter}settings*", f"guide.html#{chapter}") for chapter in _CHAPTERS)
    others = (
        ("bpy.types.fipt_light*", "guide.html#lights"),
        ("bpy.types.fipt_preferences*", "guide.html#install"),
        ("bpy.types.fipt_*", "guide.html"),
        ("bpy.ops.fipt.*", "operators.html"),
    )
    return SITE, (*sections, *others)
