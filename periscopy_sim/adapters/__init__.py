"""The light transport for other libraries: SciPy's linear operators, PyTorch's tensors."""
