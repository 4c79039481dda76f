"""The laboratory, by plain Mitsuba and Dr.Jit: nothing of the package renders them."""
