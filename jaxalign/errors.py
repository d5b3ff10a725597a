"""The one exception for what a user can mend."""

__all__ = ["UserError"]


class UserError(ValueError):
    """Bad input: the message says what is wrong, where, and how to mend it, in one line.

    The command line prints it without a traceback and exits with 2.
    """
