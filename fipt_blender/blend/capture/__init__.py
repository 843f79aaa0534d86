# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture in the scene: cameras, views, photographs before and behind the room, coverage."""
