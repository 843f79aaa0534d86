# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One mesh: its adjacency, planes, holes and normals, a scan's cleaned copy, and ray queries."""
