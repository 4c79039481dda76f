"""Studies behind single choices of the package, each runnable alone."""
