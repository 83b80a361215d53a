"""The wire protocol of the service's two Unix sockets: its messages, its clients and their back-off.

Each message is one struct, which the server sends and every client reads; fields that a client does not know are
ignored, as the service may be newer. docs/events.md and docs/control.md are made of these structs
(`service.protocol.document`).
"""
