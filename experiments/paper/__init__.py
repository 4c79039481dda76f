"""The figures and tables of the paper, each beside what this package measures."""
