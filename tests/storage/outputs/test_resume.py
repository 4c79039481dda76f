"""A folder belongs to one process at a time."""

import pytest

import periscopy_sim as ps
from periscopy_sim.storage.outputs.resume import alone_in


def test_folder_is_free_again_after_an_error(tmp_path):
    for _ in range(2):
        with pytest.raises(KeyError), alone_in(tmp_path):
            raise KeyError
    with alone_in(tmp_path), pytest.raises(ps.PeriscopyError), alone_in(tmp_path):
        pass
