"""Which triangles and pixels are one material: labels, linked masks, outlines, modelled and smooth parts."""
