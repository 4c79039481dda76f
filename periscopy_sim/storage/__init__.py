"""Files in and out: photographs, hidden images, EXR, atomic outputs and provenance."""
