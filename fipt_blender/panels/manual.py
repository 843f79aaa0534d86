"""Where panels, operators and properties are explained: the guide in the extension, or a site."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path

# Address of a documentation site (dev.py docs makes it), with a slash at the end. If empty, help opens
# the pages in the extension's zip. If set, blender_manifest.toml needs it as website, too.
SITE = ""
# The pages in the zip (docs/hooks/offline.py); a checkout has none.
PAGES = Path(__file__).resolve().parents[1] / "guide"

# Chapters of the guide, by the beginning of the names of groups of settings.
_CHAPTERS = ("photographs", "capture", "parts", "estimate", "materials", "lights", "check")


@functools.cache
def _has_pages(pages: Path) -> bool:
    """Whether the pages are there; asked by each redraw of the panels."""
    return (pages / "index.html").is_file()


def address() -> str:
    """Address of the pages, with a slash at the end; "" where there are none."""
    if SITE:
        return SITE
    return f"{PAGES.as_uri()}/" if _has_pages(PAGES) else ""


def chapter_page(chapter: str) -> str:
    """The page of a chapter of the guide below `address`; the guide's first page for ""."""
    return f"{'guide/' if SITE else ''}{chapter or 'index'}.html"


def manual_map(operators: Mapping[str, Sequence[str]]) -> tuple[str, tuple[tuple[str, str], ...]]:
    """For Blender's *Online Manual* in context menus: operators, and each section's properties.

    Without any pages, nothing is found.

    Args:
        operators: `bl_idname`s by the chapter that explains them; the site has a page of all operators.
    """
    if not address():
        return "", ()
    sections = [(f"bpy.types.fipt_{chapter}settings*", chapter_page(chapter)) for chapter in _CHAPTERS]
    others = [
        ("bpy.types.fipt_light*", chapter_page("lights")),
        ("bpy.types.fipt_preferences*", chapter_page("install")),
        ("bpy.types.fipt_*", chapter_page("")),
    ]
    if SITE:
        others.append(("bpy.ops.fipt.*", "operators.html"))
    else:
        others += [
            (f"bpy.ops.{name}", chapter_page(chapter))
            for chapter, names in operators.items()
            for name in names
        ]
        others.append(("bpy.ops.fipt.*", chapter_page("")))
    return address(), (*sections, *others)
