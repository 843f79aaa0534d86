# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From Blender to the engine: making its environment, starting its commands, running jobs of many steps."""
