"""Settings of every test run."""

from __future__ import annotations

import os

import pytest

from asimov_gym.rendering.backends import headless_backend

# Lets the tests that draw do so without a display. MuJoCo reads the backend's name once, when it is first imported, and
# the conftest modules below this one import it: so the name is set here, on import, and not in a hook.
if "MUJOCO_GL" not in os.environ and (backend := headless_backend()) is not None:
    os.environ["MUJOCO_GL"] = backend

SLOW_TIMEOUT_S = 3600.0


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests may take longer than the others before they count as hung."""
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT_S))
