# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh and cameras that do not share coordinates: the similarity from the camera solve to the room's mesh."""
