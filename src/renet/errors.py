"""The exception that renet raises for everything a user can correct."""


class RenetError(Exception):
    """Bad input or a bad file: the message names what is wrong and what to do about it.

    The command line prints it as one line and exits with code 2.
    """
