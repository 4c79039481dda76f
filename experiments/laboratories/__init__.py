"""Stand-in laboratories, of which one is the tutorial's."""

from periscopy_sim.rendering.variant import choose_llvm

choose_llvm()  # what renders them imports Mitsuba by itself
