"""What is in a log: channels, messages, senders, gaps, damage, and which signals."""
