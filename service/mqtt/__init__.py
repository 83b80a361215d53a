"""Forwarding of events to an MQTT 5 broker: a process of its own, a client of the daemon's two sockets.

Pure: `topics`, `cloudevent`, `outbox`, `states`, `vehicle_health`, `retained`, `puback_policy`, `naming`,
`throttled`. Files: `config`, `access`, `cursor` and `progress`. The daemon: `ask` and `daemon`. The
broker: `link` (through paho, with `puback_codes` and `broker_words`), `sender`, and `broker` over them.
`bridge` ties all in one loop, `command` starts it.
"""
