"""What else shapes a photograph: ambient light beyond lamps, shared noise, a gain over the wall."""
