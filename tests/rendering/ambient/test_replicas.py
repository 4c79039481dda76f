import itertools

import numpy as np
from threadpoolctl import threadpool_limits

from periscopy_sim.rendering.ambient.replicas import REPLICAS, SITES, Part
from periscopy_sim.rendering.wall_polynomials import chosen_sites

SHAPE = (126, 126)


def part_of(sites):
    def estimate(seed):
        y, x = np.divmod(sites, SHAPE[1]) / np.array(SHAPE)[:, None]
        noise = np.random.default_rng(seed).normal(size=(len(sites), 3))
        return np.outer(np.sin(7 * y + x * y), [1, 2, 3]) + 0.1 * noise

    return Part(estimate, sites, SHAPE)


def test_last_bits_do_not_follow_the_number_of_threads_of_products():
    for sites in (chosen_sites(SHAPE, SITES), np.arange(SHAPE[0] * SHAPE[1])):
        found = set()
        for threads in (1, 2):
            part = part_of(sites)
            with threadpool_limits(threads):
                part.add_round(itertools.count())
            found.add(part.field.replicas.tobytes())
        assert len(found) == 1


def test_rounds_are_averaged_and_take_further_seeds():
    part, seeds = part_of(chosen_sites(SHAPE, SITES)), itertools.count()
    part.add_round(seeds)
    once = part.field.squared_error
    for _ in range(3):
        part.add_round(seeds)
    assert part.rounds == 4 and next(seeds) == 4 * REPLICAS
    assert part.field.squared_error < once / 2
