# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh of the room, ray queries on it, the pixels of the photographs on it, and parts."""
