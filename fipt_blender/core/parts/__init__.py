# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles and pixels are one material: labels, linked masks, outlines, modelled and smooth parts."""
