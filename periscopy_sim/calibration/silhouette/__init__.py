"""An occluder nobody measured: the silhouette of a flat mask, found with the hidden image."""
