# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of files that are photographs. No imports: Blender's side reads them while it starts."""

from __future__ import annotations

RAW_SUFFIXES = (
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".rw2", ".orf", ".pef"),
    *(".srw", ".3fr", ".fff", ".iiq", ".rwl", ".erf", ".mrw", ".x3f"),
)
HEIF_SUFFIXES = (".heic", ".heif")
# Pillow's name of each format of values after a camera's response.
LDR_FORMATS = {
    **dict.fromkeys((".jpg", ".jpeg"), "JPEG"),
    **dict.fromkeys((".tif", ".tiff"), "TIFF"),
    ".png": "PNG",
    **dict.fromkeys(HEIF_SUFFIXES, "HEIF"),
}
LINEAR_SUFFIXES = (".exr", ".hdr", ".pic")
SUFFIXES = (*RAW_SUFFIXES, *LDR_FORMATS, *LINEAR_SUFFIXES)
