"""The light transport as other libraries take it: SciPy's linear operators, PyTorch's tensors."""
