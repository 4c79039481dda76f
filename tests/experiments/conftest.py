import pytest


@pytest.fixture(autouse=True)
def few_figures(request):
    """Save figures empty, but for thorough tests and those that ask for `drawings`."""
    if not request.node.get_closest_marker("thorough"):
        request.getfixturevalue("blank_figures")
