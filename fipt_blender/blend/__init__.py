# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender data into plain arrays and back: the room, cameras, UVs, materials, lights, renders."""
