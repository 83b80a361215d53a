"""What the fault memory is on a J1939 network: DM1 and DM2, and all that a node must do to be allowed to send them."""
