"""The light transport matrix A: by shadow rays, by columns, by blocks of rows."""
