# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking the estimate to textures, and the table with which Cycles shows the fitted BRDF."""
