# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Connected components: what is connected, and how components are numbered."""

import numpy as np

from fipt_blender.core.parts.components import graph_components, mesh_components


def test_components_are_numbered_by_their_lowest_nodes():
    pairs = np.array([[6, 5], [4, 1], [1, 4], [2, 2], [3, 6]])
    assert graph_components(pairs, 8).tolist() == [0, 1, 2, 3, 1, 3, 3, 4]
    assert graph_components(np.zeros((0, 2), int), 3).tolist() == [0, 1, 2]
    assert graph_components(np.zeros((0, 2), int), 0).tolist() == []


def test_triangles_are_connected_through_shared_vertices():
    corners = np.array([[7, 8, 9], [1, 2, 3], [3, 4, 5], [11, 9, 12]])
    assert mesh_components(corners).tolist() == [1, 0, 0, 1]
    assert mesh_components(np.zeros((0, 3), int)).tolist() == []
