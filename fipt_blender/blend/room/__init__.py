# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The room's meshes: export to the engine, the artist's originals, UVs and packing."""
