"""The estimation: the order of its stages, its state, its results and its previews."""
