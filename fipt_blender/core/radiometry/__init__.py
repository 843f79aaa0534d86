# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that are not HDR: response, exposures, white balances, vignetting, and their errors."""
