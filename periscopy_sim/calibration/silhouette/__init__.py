"""An occluder nobody measured: the silhouette of a flat mask, estimated with the hidden image."""
