# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene room: the mesh, ray queries on it, labels and voxels."""
