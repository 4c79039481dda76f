"""Stand-in laboratories, and what the package's commands make of them."""

from periscopy_sim.rendering.variant import choose_llvm

choose_llvm()  # what renders them imports Mitsuba by itself
