"""All that imports Mitsuba: variants, scene files, the transport matrix, photographs."""

from periscopy_sim.rendering import lcd as lcd  # whose plugin every variant gets
