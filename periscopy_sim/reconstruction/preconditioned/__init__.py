"""The paper's method: the optimized preconditioner P, denoising, repair (Algorithms 1 and 2)."""
