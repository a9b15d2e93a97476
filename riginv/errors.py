"""The one exception that means: the user can mend this."""


class InputError(ValueError):
    """Something that the user gave is wrong: commands show the message as one sentence, without a traceback.

    The message names the file or the field, what was found, what was expected, and what to do.
    """


class NonFiniteLossError(RuntimeError):
    """The training loss became NaN or infinite; the message names the step."""


def in_short(error: BaseException, most: int = 150) -> str:
    """What a library said, in one short line: some quote whole files."""
    return " ".join(str(error).split())[:most] or type(error).__name__
