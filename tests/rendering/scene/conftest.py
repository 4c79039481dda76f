import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.nodes import SceneNodes


@pytest.fixture(scope="session")
def refusal():
    """Return the message, of one line that names the file, by which a scene is refused."""

    def refuse(path, *arguments, **options):
        with pytest.raises(SceneError) as caught:
            SceneNodes(path, *arguments, **options).instantiate()
        message = str(caught.value)
        assert "\n" not in message
        assert f"'{path}'" in message
        return message

    return refuse
