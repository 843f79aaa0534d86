# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A stand-in of Blender's layout, for tests of what panels draw."""

from __future__ import annotations

from types import SimpleNamespace

import bpy


class Layout:
    """Stands in for Blender's: notes what is drawn, in this order.

    Args:
        drawn: gets the texts of labels and the names of operators.
        is_open: whether what folds is open.
        properties: gets the names of properties.
    """

    def __init__(self, drawn: list[str], is_open: bool = False, properties: list[str] | None = None) -> None:
        vars(self).update(drawn=drawn, is_open=is_open, properties=[] if properties is None else properties)

    def __setattr__(self, name: str, value: object) -> None:
        """Settings of a layout do not matter here."""

    def __getattr__(self, name: str):
        def call(*arguments, **options):
            part = Layout(self.drawn, self.is_open, self.properties)
            if name in ("label", "progress"):
                self.drawn.append(options["text"])
            elif name in ("prop", "prop_enum"):
                self.properties.append(arguments[1])
            elif name == "operator":
                self.drawn.append(arguments[0])
                return SimpleNamespace()
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
        scene=bpy.context.scene,
        space_data=None,
        mode="OBJECT",
        region=None,
        preferences=bpy.context.preferences,
    )
    drawn, properties = [], []
    layout = Layout(drawn, is_open, properties)
    panel.draw(SimpleNamespace(fields=lambda: layout, layout=layout), context)
    return drawn, properties
