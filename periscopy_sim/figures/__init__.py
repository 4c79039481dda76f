"""Everything that is drawn: panels, maps, animations, contact sheets."""
