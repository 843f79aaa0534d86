# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of files that are photographs. No imports: Blender's side reads them while it starts."""

from __future__ import annotations

RAW_SUFFIXES = (
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".rw2", ".orf", ".pef"),
    *(".srw", ".3fr", ".fff", ".iiq", ".rwl", ".erf", ".mrw", ".x3f"),
)
# Of other images, the first that is looked for where a name has none; their content says what they are.
IMAGE_SUFFIXES = (
    *(".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".heic", ".heif", ".jxl", ".pic"),
)
SUFFIXES = (*RAW_SUFFIXES, *IMAGE_SUFFIXES)
