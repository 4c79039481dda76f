"""Files in and out: formats, sequences, outputs, the library of ambient light."""
