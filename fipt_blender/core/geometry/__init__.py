# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry of scans: their noise, and a cleaned copy of their mesh with the same triangles."""
