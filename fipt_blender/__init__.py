# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Factorized Inverse Path Tracing for Blender: materials and lights of a room from its photographs.

bpy is imported only while registering, so that the engine imports as `core` where there is no bpy.
"""

from __future__ import annotations

from typing import Any

_cli_commands: list[Any] = []


def register() -> None:
    """Register the operators and `blender --command fipt`."""
    import bpy

    from . import cli, operators

    operators.register()
    _cli_commands.append(bpy.utils.register_cli_command("fipt", cli.main))


def unregister() -> None:
    """Take everything back, in reverse order."""
    import bpy

    from . import operators

    while _cli_commands:
        bpy.utils.unregister_cli_command(_cli_commands.pop())
    operators.unregister()
