"""The stand-in laboratory of the tutorial."""

from periscopy_sim.rendering.variant import choose_llvm

choose_llvm()  # what renders them imports Mitsuba by itself
