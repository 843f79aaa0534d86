# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""LLVM and CUDA discovery, Mitsuba's variant, clusters, and the command `check`."""
