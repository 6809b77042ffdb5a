"""Versions of installed packages."""

from __future__ import annotations

import mujoco
import numpy as np

from asimov_gym.versions import installed_versions


def test_what_is_installed_has_its_version_in_the_order_asked() -> None:
    found = installed_versions(["numpy", "mujoco"])
    assert list(found.items()) == [("numpy", np.__version__), ("mujoco", mujoco.__version__)]


def test_what_is_not_installed_is_left_out() -> None:
    assert installed_versions(["no-such-distribution", "numpy"]) == {"numpy": np.__version__}
