# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From photographs to posed HDR images: reading, brackets, merging, cameras, scale."""
