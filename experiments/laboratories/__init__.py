"""Stand-in laboratories, and what the package's commands make of them."""
