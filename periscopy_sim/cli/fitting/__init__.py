"""What a method is fitted to, as a command was asked for it: A, B, and the method itself."""
