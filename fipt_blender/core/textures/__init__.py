# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The texture room: fields onto UVs, and the table that makes Cycles agree."""
