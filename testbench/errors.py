"""The rig's one error that a user can cause and cure."""


class RigError(Exception):
    """What the user asked of the rig is wrong: the message says what and what to do instead, in one line."""
