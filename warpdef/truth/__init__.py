"""Known truth: the built-in figure, clouds sampled from meshes, and how a result is measured against them."""
