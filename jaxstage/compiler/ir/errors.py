"""What the compiler raises to itself."""


class LoweringError(Exception):
    """A program, type or operation has no compiled form.

    The message is the reason. It never leaves the compiler: callers turn it into a reason to
    report, or into the exception that suits them.
    """
