"""Service of a finished recording, with the sockets and the fault memory of a live one."""
