# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: gather, call, report."""

from __future__ import annotations


def register() -> None:
    """Register all operators."""
    import bpy

    from .estimate import FIPT_OT_estimate

    bpy.utils.register_class(FIPT_OT_estimate)


def unregister() -> None:
    """Take all operators back."""
    import bpy

    from .estimate import FIPT_OT_estimate

    bpy.utils.unregister_class(FIPT_OT_estimate)
