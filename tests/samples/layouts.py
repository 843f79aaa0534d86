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
    """

    def __init__(
        self,
        drawn: list[str] | None = None,
        is_open: bool = False,
        properties: list[str] | None = None,
        of: Layout | None = None,
    ) -> None:
        lists = {"drawn": drawn, "properties": properties, "labels": None, "buttons": None}
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
            elif name in ("prop", "prop_enum"):
                self.properties.append(arguments[1])
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
    context = SimpleNamespace(
        scene=bpy.context.scene, space_data=None, mode="OBJECT", region=None, preferences=bpy.context.preferences
    )
    drawn, properties = [], []
    layout = Layout(drawn, is_open, properties)
    panel.draw(SimpleNamespace(fields=lambda: layout, layout=layout), context)
    return drawn, properties


@dataclass(frozen=True)
class TabCount:
    """What the tab shows at once: sections, which of them are open, operators' and properties' names."""

    sections: tuple[str, ...]
    opened: tuple[str, ...]
    buttons: tuple[str, ...]
    settings: tuple[str, ...]


def tab_count() -> TabCount:
    """Count what the tab FIPT shows of the open scene where the artist has opened and closed nothing."""
    panels = [
        panel
        for panel in panel_package.CLASSES
        if issubclass(panel, bpy.types.Panel) and (panel.bl_space_type, panel.bl_region_type) == ("VIEW_3D", "UI")
    ]
    shown = {panel.__name__ for panel in panels if not hasattr(panel, "poll") or panel.poll(bpy.context)}
    closed = {panel.__name__ for panel in panels if "DEFAULT_CLOSED" in getattr(panel, "bl_options", ())}
    parent = {panel.__name__: getattr(panel, "bl_parent_id", "") for panel in panels}
    by_name = {panel.__name__: panel for panel in panels}

    def is_open(name: str) -> bool:
        return name in shown and name not in closed and (not parent[name] or is_open(parent[name]))

    buttons, settings = [], []
    for name in filter(is_open, by_name):
        drawn, properties = drawn_by(by_name[name])
        buttons += [text for text in drawn if text.startswith(("fipt.", "preferences.", "wm."))]
        settings += properties
    sections = [name for name in shown if not parent[name]]
    sections.sort(key=lambda name: by_name[name].bl_order)
    return TabCount(
        tuple(by_name[name].bl_label for name in sections),
        tuple(by_name[name].bl_label for name in sections if is_open(name)),
        tuple(buttons),
        tuple(settings),
    )
