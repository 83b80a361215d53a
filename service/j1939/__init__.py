"""Trouble codes on a J1939 network: DM1 and DM2, and what a node must do to be allowed to send them."""
