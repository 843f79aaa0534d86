# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A stand-in of Blender's layout, for tests of what panels draw."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import bpy

from fipt_blender import panels as panel_package


class Layout:
    """Stands in for Blender's: notes what is drawn, in this order.

    Args:
        drawn: gets the texts of labels and the names of operators.
        is_open: whether what folds is open.
        properties: gets the names of properties.

    Attributes:
        labels: the options of labels.
        buttons: the operators' settings, with `name` and `text`.
        more: other buttons: items of enumerations, and what opens menus.
    """

    def __init__(
        self,
        drawn: list[str] | None = None,
        is_open: bool = False,
        properties: list[str] | None = None,
        of: Layout | None = None,
    ) -> None:
        lists = {"drawn": drawn, "properties": properties, "labels": None, "buttons": None, "more": None}
        made = {name: [] if value is None else value for name, value in lists.items()}
        vars(self).update(vars(of) if of else {"is_open": is_open, **made})

    def __setattr__(self, name: str, value: object) -> None:
        """Settings of a layout do not matter here."""

    def __getattr__(self, name: str):
        def call(*arguments, **options):
            part = Layout(of=self)
            if name in ("label", "progress"):
                self.drawn.append(options["text"])
                self.labels.append(options)
            elif name == "prop":
                self.properties.append(arguments[1])
            elif name in ("prop_enum", "popover", "menu", "operator_menu_enum"):
                self.more.append(name)
            elif name == "operator":
                self.drawn.append(arguments[0])
                self.buttons.append(SimpleNamespace(name=arguments[0], text=options.get("text", "")))
                return self.buttons[-1]
            elif name == "panel":
                return part, part if self.is_open else None
            return part

        return call


def drawn_by(panel: type, is_open: bool = False) -> tuple[list[str], list[str]]:
    """What a panel draws of the open scene: labels and operators; names of properties.

    Args:
        is_open: whether what folds inside the panel is open.
    """
    layout = Layout(is_open=is_open)
    panel.draw(SimpleNamespace(layout=layout), _context())
    return layout.drawn, layout.properties


def _context(shading: SimpleNamespace | None = None) -> SimpleNamespace:
    """The open scene in a 3D view of a shading, or in none."""
    space = None if shading is None else SimpleNamespace(shading=shading, as_pointer=lambda: 1)
    return SimpleNamespace(
        scene=bpy.context.scene, space_data=space, mode="OBJECT", region=None, preferences=bpy.context.preferences
    )


@dataclass(frozen=True)
class TabCount:
    """What the tab shows at once: sections, which of them are open; buttons, properties and texts."""

    sections: tuple[str, ...]
    opened: tuple[str, ...]
    buttons: tuple[str, ...]
    settings: tuple[str, ...]
    texts: tuple[str, ...]


def tab_count(shading: str = "SOLID") -> TabCount:
    """Count what the tab FIPT shows of the open scene where the artist has opened and closed nothing, in headers, too.

    Args:
        shading: type of the 3D view's.
    """
    panels = [
        panel
        for panel in panel_package.CLASSES
        if issubclass(panel, bpy.types.Panel) and (panel.bl_space_type, panel.bl_region_type) == ("VIEW_3D", "UI")
    ]
    shown = {panel.__name__: panel for panel in panels if panel.poll(bpy.context)}

    def is_open(name: str) -> bool:
        panel = shown.get(name)
        parent = getattr(panel, "bl_parent_id", "")
        return panel is not None and "DEFAULT_CLOSED" not in panel.bl_options and (not parent or is_open(parent))

    layout = Layout()
    for name, panel in shown.items():
        drawing = (SimpleNamespace(layout=layout), _context(SimpleNamespace(type=shading)))
        parent = getattr(panel, "bl_parent_id", "")
        if not parent or is_open(parent):
            panel.draw_header_preset(*drawing)
        if is_open(name):
            panel.draw(*drawing)
    sections = sorted(
        (panel for panel in shown.values() if not getattr(panel, "bl_parent_id", "")), key=lambda panel: panel.bl_order
    )
    buttons = [button.name for button in layout.buttons]
    return TabCount(
        tuple(panel.bl_label for panel in sections),
        tuple(panel.bl_label for panel in sections if is_open(panel.__name__)),
        (*buttons, *layout.more),
        tuple(layout.properties),
        tuple(text for text in layout.drawn if text not in buttons),
    )
