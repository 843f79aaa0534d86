"""A forward path tracer with the paper's BRDF: ground truth and re-renders for benchmarks and tests."""
