"""One mesh: its adjacency, planes, holes and normals, a scan's cleaned copy, and ray queries."""
