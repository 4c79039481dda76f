"""The unrolled network's training: pictures, samples, steps."""
