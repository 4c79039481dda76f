"""Commands for a first hour: `doctor`, `demo` and `tutorial`."""
