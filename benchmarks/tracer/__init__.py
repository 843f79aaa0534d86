# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A forward path tracer with the paper's BRDF: ground truth and re-renders for benchmarks and tests."""
