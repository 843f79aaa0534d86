# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of the photographs of this capture that are not HDR: codes, gains and clipped surfaces."""
