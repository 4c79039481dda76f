"""The model y = g ∘ (A f) + B b + e of a photograph, fitted to one scene and the pixels used."""
