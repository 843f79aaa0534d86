# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The foundation: run folder, settings, messages, errors, checkpoints. It imports no other room."""
