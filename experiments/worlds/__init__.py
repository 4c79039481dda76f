"""Hidden worlds other than a monitor, photographed by plain Mitsuba and reconstructed."""
