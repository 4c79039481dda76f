"""The minimization behind the noise-aware method, and the basis that makes it quick."""
