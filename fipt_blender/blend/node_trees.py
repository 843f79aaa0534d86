# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees of materials and worlds in every supported version of Blender."""

from __future__ import annotations

import bpy


def node_tree(owner: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """The node tree of a material or world; up to Blender 4.5 it exists only once nodes are used."""
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree
