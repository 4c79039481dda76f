"""How a photograph shows a plane wall, by marks on it: points, or square tags."""
