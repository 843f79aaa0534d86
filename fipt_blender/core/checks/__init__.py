# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of the photographs against each other and the mesh: exposures, camera poses, lamps that it lacks."""
