# Generated from proto/recording.proto by proto/generate.py. Do not edit.
"""Messages of the protobuf package ``asimov_gym.recording``."""

from google.protobuf import descriptor_pool as _descriptor_pool
from google.protobuf.internal import builder as _builder

DESCRIPTOR = _descriptor_pool.Default().AddSerializedFile(
    b"\x0a$asimov_gym/edge/wire/recording.proto\x12\x14asimov_gym.recording\x22u\x0a\x0fRecordedComman"
    b"d\x12\x13\x0a\x0breceived_us\x18\x01 \x01(\x04\x12\x0e\x0a\x06client\x18\x02 \x01(\x09\x12\x0f\x0a"
    b"\x07payload\x18\x03 \x01(\x0c\x12\x0c\x0a\x04kind\x18\x04 \x01(\x09\x12\x0f\x0a\x07verdict\x18\x05"
    b" \x01(\x09\x12\x0d\x0a\x05notes\x18\x06 \x03(\x09b\x06proto3"
)

_globals = globals()
_builder.BuildMessageAndEnumDescriptors(DESCRIPTOR, _globals)
_builder.BuildTopDescriptorsAndMessages(DESCRIPTOR, "asimov_gym.edge.wire.recording_pb2", _globals)
