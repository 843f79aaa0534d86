# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: Factorized Inverse Path Tracing without Blender (mitsuba, drjit, torch; never bpy)."""
