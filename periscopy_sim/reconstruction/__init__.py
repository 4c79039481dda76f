"""From a photograph to the hidden image: arrays in, arrays out."""
