"""Making a data set: random draws, geometries, ambient light, samples."""
