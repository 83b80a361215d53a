"""A finished recording, answered about as the service on the vehicle answers: same sockets, same fault memory."""
