"""Sequences of frames, each decoded when its turn comes."""
