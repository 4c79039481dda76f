"""What scene and hidden image leave of a photograph: how much, whether it is noise, and why not."""
