# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scan lacks: panes in flat holes, lost surfaces and torn parts."""
