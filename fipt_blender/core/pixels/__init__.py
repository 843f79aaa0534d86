# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the photographs' pixels see: rays, grouped sums, mixed pixels and their unmixing."""
