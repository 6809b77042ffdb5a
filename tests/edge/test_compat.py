"""The import path of the published samples."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from asimov_gym.edge import compat
from asimov_gym.edge.wire import cloud_pb2


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    compat.uninstall()
    yield
    compat.uninstall()


def test_nothing_is_there_unless_asked_for() -> None:
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("edge.generated.edge_cloud_pb2")


def test_every_way_of_importing_leads_to_our_messages() -> None:
    compat.install()
    compat.install()
    messages = importlib.import_module("edge.generated.edge_cloud_pb2")
    assert sys.modules["edge"].generated.edge_cloud_pb2 is messages
    namespace: dict[str, object] = {}
    exec(
        "from edge.generated.edge_cloud_pb2 import CloudCommand, Mode\nfrom edge.generated import edge_cloud_pb2",
        namespace,
    )
    assert namespace["CloudCommand"] is cloud_pb2.CloudCommand
    assert messages.Mode.MODE_DAMP == 1 and messages.MODE_STAND == 0
    assert messages.FirmwareMode.Name(2) == "FW_MODE_MOVE"


def test_every_message_and_enum_is_there() -> None:
    compat.install()
    messages = importlib.import_module("edge.generated.edge_cloud_pb2")
    descriptor = cloud_pb2.DESCRIPTOR
    values = [value for enum in descriptor.enum_types_by_name.values() for value in enum.values_by_name]
    names = [*descriptor.message_types_by_name, *descriptor.enum_types_by_name, *values]
    assert len(names) > 20
    assert [name for name in names if getattr(messages, name, None) is not getattr(cloud_pb2, name)] == []


def test_taken_away_again() -> None:
    compat.install()
    command = importlib.import_module("edge.generated.edge_cloud_pb2").CloudCommand
    compat.uninstall()
    compat.uninstall()
    assert not any(name in sys.modules for name in compat.PATH)
    assert command(sequence=3).sequence == 3


def test_another_package_that_is_imported_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    other = ModuleType("edge")
    monkeypatch.setitem(sys.modules, "edge", other)
    with pytest.raises(ImportError, match="there is another package 'edge'"):
        compat.install()
    compat.uninstall()
    assert sys.modules["edge"] is other


def test_another_package_that_is_installed_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "edge").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    compat.install()  # a folder without code is nobody's package
    compat.uninstall()
    (tmp_path / "edge" / "__init__.py").write_text("")
    importlib.invalidate_caches()
    with pytest.raises(ImportError, match=str(tmp_path)):
        compat.install()
