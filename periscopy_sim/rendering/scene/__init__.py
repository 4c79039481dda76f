"""Scene files: which files they name, their nodes, their meshes, loading them."""
