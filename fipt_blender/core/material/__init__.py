# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimation of materials: the closed-form initial estimate, the networks and their training."""
