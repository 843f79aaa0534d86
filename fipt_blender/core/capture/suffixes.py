"""Names of files that are photographs. No imports: Blender's side reads them while it starts."""

from __future__ import annotations

RAW_SUFFIXES = (
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".rw2", ".orf", ".pef"),
    *(".srw", ".3fr", ".fff", ".iiq", ".rwl", ".erf", ".mrw", ".x3f"),
)
LINEAR_SUFFIXES = (".exr", ".hdr", ".pic")
HEIF_SUFFIXES = (".heic", ".heif", ".hif")  # the last one of cameras
# Of images that are not RAW; their content says what they are.
IMAGE_SUFFIXES = (
    *LINEAR_SUFFIXES,
    *(".png", ".jpg", ".jpeg", ".jfif", ".jpe", ".insp", ".tif", ".tiff", ".webp", ".jxl"),
    *HEIF_SUFFIXES,
)
SUFFIXES = (*RAW_SUFFIXES, *IMAGE_SUFFIXES)
