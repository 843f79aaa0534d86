# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth to mesh: range images fused into a truncated signed distance field, and its surface."""
