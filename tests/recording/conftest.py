"""A recorded run in lockstep with everything in it, and one that an earlier version left behind."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.recording.rehearsal import record_run

OLD = Path(__file__).parents[1] / "data" / "recording_0_1.mcap"
"""Two seconds in lockstep with the shipped policy and seed 3, from before there were log lines, frames of the other
dialect, and commands that say over which lane they came."""


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "folder" / "run.mcap"
    record_run(path)
    return path


@pytest.fixture(scope="session")
def old_recording() -> Path:
    return OLD


@pytest.fixture(autouse=True)
def log_level() -> Iterator[None]:
    """The level of the project's logger as Python has it by default, whatever another test left."""
    logger = logging.getLogger("asimov_gym")
    before = logger.level
    logger.setLevel(logging.NOTSET)
    yield
    logger.setLevel(before)
