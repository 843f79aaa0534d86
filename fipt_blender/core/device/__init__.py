# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The device room: finding LLVM or CUDA, and the one place that sets Mitsuba's variant."""
