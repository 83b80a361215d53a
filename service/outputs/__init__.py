"""Where events go: views of the one stream of events."""
