"""What holds for the tests of the editor: a real browser for the page, and servers that stop at once."""

import pytest

from facetrack_cli.editor import server as server_module
from tests.support.browser import browser, command, fix, pick, served, windows  # noqa: F401 -- fixtures


@pytest.fixture(scope="session", autouse=True)
def quick_servers():
    """Servers of this process look every 5 ms whether they are to stop."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server_module, "POLL_S", 0.005)
        yield
