"""The generated modules are those of the .proto files."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType

import pytest

from asimov_gym.edge.wire import cloud_pb2, io_pb2, recording_pb2

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    pytest.importorskip("grpc_tools", reason="needs the protobuf compiler: pip install grpcio-tools")
    spec = importlib.util.spec_from_file_location("generate", ROOT / "proto" / "generate.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_modules_are_current(generator: ModuleType) -> None:
    for name, text in generator.modules().items():
        assert (generator.TARGET_DIR / name).read_text() == text, f"{name} is out of date: run python proto/generate.py"


def test_every_field_is_in_the_stubs() -> None:
    for module in (cloud_pb2, io_pb2, recording_pb2):
        stub = Path(str(module.__file__)).with_suffix(".pyi").read_text()
        for message in module.DESCRIPTOR.message_types_by_name.values():
            for field in message.fields:
                assert f"{field.name.upper()}_FIELD_NUMBER" in stub, field.full_name


def test_stubs_are_current(generator: ModuleType) -> None:
    pytest.importorskip("mypy_protobuf", reason="needs the stub generator: pip install mypy-protobuf")
    written_with = (5, 1)
    have = tuple(int(part) for part in metadata.version("mypy-protobuf").split(".")[:2])
    if have != written_with:
        pytest.skip(f"the stubs were written with mypy-protobuf {written_with}, this is {have}: texts may differ")
    for name, text in generator.stubs().items():
        assert (generator.TARGET_DIR / name).read_text() == text, f"{name} is out of date: run python proto/generate.py"


def test_edge_needs_neither_jax_nor_torch() -> None:
    code = "import sys, asimov_gym.edge, asimov_gym.recording; print([m for m in ('jax', 'torch') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"
