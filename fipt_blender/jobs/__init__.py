# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs on run folders and the data folder, and the one job that runs in a window."""
