"""From photographs to posed HDR images: reading, brackets, merging, cameras, scale."""
