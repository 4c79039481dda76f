"""All that imports Mitsuba: variants, scene files, the transport matrix, photographs."""
