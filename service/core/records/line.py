"""Messages and records as lines of JSON."""

import msgspec

_ENCODER = msgspec.json.Encoder()


def encode(message: msgspec.Struct) -> bytes:
    """Return the message as one line of JSON, newline included."""
    return _ENCODER.encode(message) + b"\n"
