"""LLVM and CUDA discovery, Mitsuba's variant, clusters, and the command `check`."""
