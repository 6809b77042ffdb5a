"""What a suite's run has finished so far, a JSON line each, so that it can be stopped and continued at any time."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from asimov_gym.evaluation.results import TrialResult, plain, trial_from_json

HEADER_FILE = "run.json"
TRIALS_FILE = "trials.jsonl"
TRACES_FOLDER = "traces"
_IDENTITY = ("suite_hash", "policy_hash")


class RunFolderError(ValueError):
    """A run folder that cannot be begun or continued as asked."""


class Journal:
    """The run folder of a suite.

    Args:
        folder: where; made when it is missing.
        header: what the run is, with `suite`, `suite_hash`, `policy_name` and `policy_hash`.
        resume: continue the run that is there, instead of beginning one.

    Raises:
        RunFolderError: a run is there and is not to be continued, none is there to continue, or the one there is of
            another suite or policy.
    """

    def __init__(self, folder: Path, header: dict[str, Any], resume: bool = False) -> None:
        self.folder = folder
        self.trials: dict[tuple[str, int], TrialResult] = {}
        """Finished trials by scenario and repeat."""
        self.pushes: dict[tuple[str, float, int], bool] = {}
        """Whether the robot survived, by push limit search, force (N) and repeat."""
        there = (folder / HEADER_FILE).is_file()
        if there and not resume:
            raise RunFolderError(f"{folder} holds a run already: continue it with --resume, or choose another folder")
        if resume and not there:
            raise RunFolderError(f"{folder} holds no run that could be continued")
        if resume:
            self.header = json.loads((folder / HEADER_FILE).read_text(encoding="utf-8"))
            for key in _IDENTITY:
                if self.header.get(key) != header[key]:
                    what = key.removesuffix("_hash")
                    raise RunFolderError(
                        f"{folder} is a run with another {what} ({self.header.get(key)!r} there, {header[key]!r} "
                        "now): choose another folder"
                    )
            self._read()
        else:
            folder.mkdir(parents=True, exist_ok=True)
            self.header = header
        self.save_header()
        self._file = (folder / TRIALS_FILE).open("a", encoding="utf-8")

    def save_header(self) -> None:
        """Write the header as it is now; a reader never sees half of it."""
        part = self.folder / f"{HEADER_FILE}.part"
        part.write_text(json.dumps(plain(self.header), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        os.replace(part, self.folder / HEADER_FILE)

    def add_trials(self, results: Iterable[TrialResult]) -> None:
        """Keep finished trials; they are on the disk when this returns."""
        lines = []
        for result in results:
            self.trials[result.scenario, result.repeat] = result
            lines.append({"trial": plain(asdict(result))})
        self._append(lines)

    def add_pushes(self, survived: Iterable[tuple[str, float, int, bool]]) -> None:
        """Keep trials of push limit searches: search, force (N), repeat, survived."""
        lines = []
        for search, force, repeat, up in survived:
            self.pushes[search, force, repeat] = up
            lines.append({"push": [search, force, repeat, up]})
        self._append(lines)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, lines: list[dict[str, Any]]) -> None:
        for line in lines:
            self._file.write(json.dumps(line, allow_nan=False) + "\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self) -> None:
        path = self.folder / TRIALS_FILE
        if not path.is_file():
            return
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):  # the last line was cut off when the run was killed
            path.write_bytes(whole)
        for number, line in enumerate(whole.decode().splitlines(), start=1):
            try:
                entry = json.loads(line)
                if "trial" in entry:
                    result = trial_from_json(entry["trial"])
                    self.trials[result.scenario, result.repeat] = result
                else:
                    search, force, repeat, up = entry["push"]
                    self.pushes[search, force, repeat] = up
            except (ValueError, TypeError, KeyError) as error:
                raise RunFolderError(f"{path}, line {number} cannot be read: {error}") from error
