"""HTTP: the fault memory, the records and live values for tools, in a process of its own.

It is a client of the daemon's two sockets and opens nothing else of the daemon's, so that no browser can hold up an
alarm. What a caller sees is in docs/http.md.
"""
