"""The closed-form twins of the rendering, independent of the ray tracer."""
