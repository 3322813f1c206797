"""Writer of an MCAP file: the only module that imports mcap and protobuf.

Contents are dicts in the form of their schemas (`harness.export.messages`). Equal messages give equal bytes.
"""

import importlib
from collections.abc import Iterable, Mapping
from typing import IO

import msgspec
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message as ProtobufMessage
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, IndexType, Writer

from harness.export.messages import Message, Topic

CHUNK_BYTES = 1 << 20
"""Size of a chunk before compression; a viewer reads whole chunks."""
_INDEXES = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
"""An index of attachments, of which there are none, would be a reference to nothing."""
_FOXGLOVE = "foxglove"


class McapFile:
    """An MCAP file that is written to a stream; `finish` completes it.

    ``epoch_ns`` is the date of simulated time 0, UNIX time: all times in the file are of the simulation.
    """

    def __init__(self, stream: IO[bytes], *, epoch_ns: int) -> None:
        self._writer = Writer(
            stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, index_types=_INDEXES
        )
        self._writer.start(library=f"coflight; {LIBRARY_IDENTIFIER}")
        self._epoch_ns = epoch_ns
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, _Channel] = {}
        self._encoder = msgspec.json.Encoder()

    def add_topic(self, topic: Topic) -> None:
        """Declare a topic, also if it gets no message."""
        is_json = topic.json_schema is not None
        protobuf = None if is_json else foxglove_class(topic.schema)
        if topic.schema not in self._schemas:
            data = self._encoder.encode(topic.json_schema) if protobuf is None else descriptors_of(protobuf)
            encoding = SchemaEncoding.JSONSchema if is_json else SchemaEncoding.Protobuf
            self._schemas[topic.schema] = self._writer.register_schema(topic.schema, encoding, data)
        number = self._writer.register_channel(
            topic.name,
            MessageEncoding.JSON if is_json else MessageEncoding.Protobuf,
            self._schemas[topic.schema],
            {"description": topic.description},
        )
        self._channels[topic.name] = _Channel(number, protobuf)

    def add(self, messages: Iterable[Message]) -> None:
        """Write messages of declared topics. Raises OSError, and KeyError for another topic."""
        encode, add_message, epoch_ns = self._encoder.encode, self._writer.add_message, self._epoch_ns
        for time_ns, topic, content in messages:
            channel, unix_ns = self._channels[topic], epoch_ns + time_ns
            protobuf = channel.protobuf
            data = encode(content) if protobuf is None else protobuf(**content).SerializeToString()
            add_message(channel.number, unix_ns, data, unix_ns, channel.count)
            channel.count += 1

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Write a record of metadata. Raises OSError."""
        self._writer.add_metadata(name, dict(content))

    def finish(self) -> None:
        """Write what remains, and the index. Raises OSError."""
        self._writer.finish()  # type: ignore[no-untyped-call] # the library has none


class _Channel:
    """A channel of the file, and the number of its messages."""

    __slots__ = ("count", "number", "protobuf")

    def __init__(self, number: int, protobuf: type[ProtobufMessage] | None) -> None:
        self.number, self.protobuf = number, protobuf
        self.count = 0


def foxglove_class(schema: str) -> type[ProtobufMessage]:
    """Return the class of one of Foxglove's schemas, such as ``foxglove.SceneUpdate``."""
    package, _, name = schema.partition(".")
    if package != _FOXGLOVE:
        raise ValueError(f"{schema}: no schema of Foxglove")
    found: type[ProtobufMessage] = getattr(
        importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name
    )
    return found


def descriptors_of(protobuf: type[ProtobufMessage]) -> bytes:
    """Return the FileDescriptorSet of a class: its file and all that this imports, imported ones first."""
    found, seen = FileDescriptorSet(), set[str]()

    def add(file: FileDescriptor) -> None:
        if file.name not in seen:
            seen.add(file.name)
            for imported in file.dependencies:
                add(imported)
            file.CopyToProto(found.file.add())

    add(protobuf.DESCRIPTOR.file)
    data: bytes = found.SerializeToString()
    return data
