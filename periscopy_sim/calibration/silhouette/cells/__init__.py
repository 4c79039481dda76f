"""A flat mask cut into cells: where it lies, how fine it may be, what it shadows, its mesh."""
