"""A formula for an effect that no entry of the library describes: composed, fitted, and proposed for review."""
