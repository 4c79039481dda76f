import copy
import pickle
import threading
import time

import pytest

from periscopy_sim.memo import Memo


class Maker:
    """Make an object anew at each call, and count these."""

    calls = 0

    def __call__(self):
        self.calls += 1
        return object()


def test_a_key_has_one_object():
    memo, make = Memo(), Maker()
    assert memo.get("a", make) is memo.get("a", make) is not memo.get("b", make)
    assert make.calls == 2


def test_the_least_recently_used_make_room():
    memo, make = Memo(10), Maker()
    kept = {key: memo.get(key, make, size) for key, size in (("a", 4), ("b", 4), ("light", 0))}
    assert memo.get("a", make, 4) is kept["a"]
    memo.get("c", make, 4)
    assert memo.get("a", make, 4) is kept["a"] and memo.get("light", make) is kept["light"]
    assert memo.get("b", make, 4) is not kept["b"]
    large = memo.get("large", make, 1000)
    assert memo.get("large", make, 1000) is large and memo.get("light", make) is kept["light"]
    assert memo.get("a", make, 4) is not kept["a"]


def test_what_a_failing_make_leaves_is_made_again():
    def fail():
        raise ValueError("lost")

    memo = Memo()
    for _ in range(2):
        with pytest.raises(ValueError, match="lost"):
            memo.get("a", fail)
    assert memo.get("a", lambda: 1) == 1


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda memo: pickle.loads(pickle.dumps(memo))]
)
def test_a_copy_begins_empty(copied):
    memo, make = Memo(7), Maker()
    first = memo.get("a", make)
    other = copied(memo)
    assert other.most_bytes == 7 and other.get("a", make) is not first
    assert memo.get("a", make) is first


def test_threads_make_things_in_turn_and_each_once():
    memo, running, made, together = Memo(), [], [], []

    def make():
        running.append(threading.get_ident())
        time.sleep(0.02)
        together.append(len(running))
        running.pop()
        return object()

    threads = [
        threading.Thread(target=lambda key=key: made.append((key, memo.get(key, make))))
        for key in "aabb" * 2
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == [1, 1] and len({*made}) == 2
