# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflection and emission: the BRDF, area lights, the environment; and the denoiser."""
