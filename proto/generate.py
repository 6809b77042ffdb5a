"""Regenerate the message modules in ``asimov_gym/edge/wire`` from the ``.proto`` files beside this script.

Usage: ``python proto/generate.py`` writes; ``python proto/generate.py --check`` only compares and exits with 1 when a
module is out of date. Needs grpcio-tools (for the parser) and mypy-protobuf (for the type stubs).

The modules are written from the parsed descriptors and not with protoc's own Python back end. Its output refuses to
load under a protobuf runtime older than the compiler, so it would tie every user to the newest runtime; these messages
use nothing that protobuf 5.29 does not know.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from google.protobuf import descriptor_pb2

SOURCE_DIR = Path(__file__).resolve().parent
TARGET_DIR = SOURCE_DIR.parent / "asimov_gym" / "edge" / "wire"
#: Path of the files inside the descriptor pool. It makes the names unique in a process that loads other packages'
#: ``.proto`` files, and puts the stubs' imports right.
POOL_DIR = "asimov_gym/edge/wire"

MODULE = '''\
# Generated from proto/{stem}.proto by proto/generate.py. Do not edit.
"""Messages of the protobuf package ``{package}``."""

from google.protobuf import descriptor_pool as _descriptor_pool
{imports}from google.protobuf.internal import builder as _builder

DESCRIPTOR = _descriptor_pool.Default().AddSerializedFile(
{literal}
)

_globals = globals()
_builder.BuildMessageAndEnumDescriptors(DESCRIPTOR, _globals)
_builder.BuildTopDescriptorsAndMessages(DESCRIPTOR, "{module}", _globals)
'''


def sources() -> list[Path]:
    """The ``.proto`` files, sorted by name."""
    return sorted(SOURCE_DIR.glob("*.proto"))


def _protoc(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{POOL_DIR}={SOURCE_DIR}", *arguments]
    subprocess.run(command, check=True, cwd=SOURCE_DIR)


def _bytes_literal(data: bytes, width: int = 96) -> str:
    """``data`` as indented, implicitly joined bytes literals of about ``width`` characters."""
    lines, line = [], ""
    for byte in data:
        char = chr(byte)
        line += char if 32 <= byte < 127 and char not in '"\\' else f"\\x{byte:02x}"
        if len(line) >= width:
            lines.append(line)
            line = ""
    if line:
        lines.append(line)
    return "\n".join(f'    b"{part}"' for part in lines)


def _import(dependency: str) -> str:
    """The statement that puts a file of protobuf's own into the descriptor pool."""
    folder, _, name = dependency.removesuffix(".proto").rpartition("/")
    if folder != "google/protobuf":
        raise ValueError(f"{dependency}: only protobuf's own files can be imported")
    return f"from google.protobuf import {name}_pb2 as _{name}_pb2  # noqa: F401"


def modules() -> dict[str, str]:
    """Text of every ``*_pb2.py``, by file name."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "set.pb"
        _protoc([f"--descriptor_set_out={out}", *(f"{POOL_DIR}/{path.name}" for path in sources())])
        parsed = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes())
    texts = {}
    for file in parsed.file:
        for message in file.message_type:
            for field in message.field:
                field.ClearField("json_name")  # derived from the name: dead weight
        stem = Path(file.name).stem
        texts[f"{stem}_pb2.py"] = MODULE.format(
            stem=stem,
            package=file.package,
            imports="".join(f"{_import(name)}\n" for name in file.dependency),
            literal=_bytes_literal(file.SerializeToString(deterministic=True)),
            module=f"{POOL_DIR.replace('/', '.')}.{stem}_pb2",
        )
    return texts


def stubs() -> dict[str, str]:
    """Text of every ``*_pb2.pyi``, by file name. Depends on the version of mypy-protobuf."""
    plugin = shutil.which("protoc-gen-mypy", path=str(Path(sys.executable).parent)) or shutil.which("protoc-gen-mypy")
    if plugin is None:
        raise FileNotFoundError("protoc-gen-mypy not found: pip install mypy-protobuf")
    with tempfile.TemporaryDirectory() as folder:
        names = [f"{POOL_DIR}/{path.name}" for path in sources()]
        _protoc([f"--plugin=protoc-gen-mypy={plugin}", "--mypy_out=quiet:" + folder, *names])
        return {path.name: path.read_text() for path in (Path(folder) / POOL_DIR).glob("*.pyi")}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args().check
    stale = []
    for name, text in (modules() | stubs()).items():
        target = TARGET_DIR / name
        if not target.exists() or target.read_text() != text:
            stale.append(name)
            if not check:
                target.write_text(text)
    print(("out of date: " if check else "written: ") + (", ".join(stale) or "nothing"))
    return 1 if check and stale else 0


if __name__ == "__main__":
    raise SystemExit(main())
