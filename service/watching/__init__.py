"""`faultline watch` on a terminal: a live screen, drawn anew in place."""
