# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures, added lights and the environment: how they shine, and their conversion to Blender lights."""
