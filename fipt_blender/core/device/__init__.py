# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""LLVM and CUDA discovery, the Mitsuba variant, and the `check` command."""
