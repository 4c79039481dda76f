"""The method `preconditioned`: the optimized P, denoising, repair (Algorithms 1 and 2)."""
