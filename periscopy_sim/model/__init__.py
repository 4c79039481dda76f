"""The model y = g ∘ (A f) + B c + n of a photograph, fitted to one scene and the pixels used."""
