"""The records that leave the core: event, fault, freeze frame, health."""
