"""The methods that the paper compares with: differencing [15] and a truncated SVD."""
