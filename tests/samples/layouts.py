# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A stand-in of Blender's layout, for tests of what panels draw."""

from __future__ import annotations

from types import SimpleNamespace


class Layout:
    """Stands in for Blender's: notes labels and operators in the order in which they are drawn."""

    def __init__(self, drawn: list[str], is_open: bool = False) -> None:
        vars(self).update(drawn=drawn, is_open=is_open)

    def __setattr__(self, name: str, value: object) -> None:
        """Settings of a layout do not matter here."""

    def __getattr__(self, name: str):
        def call(*arguments, **options):
            if name in ("label", "progress"):
                self.drawn.append(options["text"])
            elif name == "operator":
                self.drawn.append(arguments[0])
                return SimpleNamespace()
            elif name == "panel":
                return Layout(self.drawn), Layout(self.drawn) if self.is_open else None
            return Layout(self.drawn, self.is_open)

        return call
