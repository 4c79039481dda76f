"""The film of a scene's camera: how many pixels, where a photograph shows them, averages."""
