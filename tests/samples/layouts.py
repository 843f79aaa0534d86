"""A stand-in of Blender's layout, for tests of what panels draw."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import bpy

from fipt_blender import panels as panel_package


class Layout:
    """Stands in for Blender's, where nothing that folds is open: notes what is drawn, in this order.

    Attributes:
        drawn: texts of labels, and names of operators.
        properties: their names.
        buttons: names of operators, and kinds of other buttons: items of enumerations, and what opens menus.
    """

    def __init__(self, of: Layout | None = None) -> None:
        vars(self).update(vars(of) if of else {"drawn": [], "properties": [], "buttons": []})

    def __setattr__(self, name: str, value: object) -> None:
        """Settings of a layout do not matter here."""

    def __getattr__(self, name: str):
        def call(*arguments, **options):
            if name in ("label", "progress"):
                self.drawn.append(options["text"])
            elif name == "prop":
                self.properties.append(arguments[1])
            elif name in ("prop_enum", "popover", "menu", "operator_menu_enum"):
                self.buttons.append(name)
            elif name == "operator":
                self.drawn.append(arguments[0])
                self.buttons.append(arguments[0])
                return SimpleNamespace()
            part = Layout(of=self)
            return (part, None) if name == "panel" else part

        return call


def drawn_by(panel: type) -> tuple[list[str], list[str]]:
    """What a panel draws of the open scene: labels and operators; names of properties."""
    layout = Layout()
    panel.draw(SimpleNamespace(layout=layout), _context())
    return layout.drawn, layout.properties


def _context() -> SimpleNamespace:
    """The open scene in a 3D view."""
    space = SimpleNamespace(shading=SimpleNamespace(type="SOLID"))
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


def tab_count() -> TabCount:
    """Count what the tab FIPT shows of the open scene where the artist has opened nothing, in headers, too."""
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
        drawing = (SimpleNamespace(layout=layout), _context())
        parent = getattr(panel, "bl_parent_id", "")
        if not parent or is_open(parent):
            panel.draw_header_preset(*drawing)
        if is_open(name):
            panel.draw(*drawing)
    sections = sorted(
        (panel for panel in shown.values() if not getattr(panel, "bl_parent_id", "")), key=lambda panel: panel.bl_order
    )
    return TabCount(
        tuple(panel.bl_label for panel in sections),
        tuple(panel.bl_label for panel in sections if is_open(panel.__name__)),
        tuple(layout.buttons),
        tuple(layout.properties),
        tuple(text for text in layout.drawn if text not in layout.buttons),
    )
