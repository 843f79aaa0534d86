# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The way from Blender to the engine: its interpreter, what that needs from the system, the child process."""
