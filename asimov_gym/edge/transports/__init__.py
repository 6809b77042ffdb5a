"""Lanes between the edge and the world, one module each. Import the one that is needed: they have dependencies of their
own."""


class TransportError(RuntimeError):
    """A lane cannot be opened; the message is one line for the person who asked for it."""
