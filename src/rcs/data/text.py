"""Text that can be stored: UTF-8 has no place for half of a surrogate pair, which Python strings may have."""

from __future__ import annotations

from typing import Any

from rcs.errors import InvalidSetup


def is_storable(text: str) -> bool:
    """Return whether a text can be written as UTF-8."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def check_text(text: object, what: str) -> None:
    """Refuse what is no text, or a text that could not be stored.

    Half of a surrogate pair comes from arguments of a command that are no UTF-8, or from an emoji that was cut in two.

    Args:
        text: What was given.
        what: What it is, for the message, such as "The instruction".

    Raises:
        InvalidSetup: It is no text, or has half of a surrogate pair.
    """
    if not isinstance(text, str):
        raise InvalidSetup(f"{what} must be text, not {type(text).__name__}.")
    if not is_storable(text):
        place = next(i for i, letter in enumerate(text) if "\ud800" <= letter <= "\udfff")
        raise InvalidSetup(
            f"{what} is {text!r}, and its character {place} is half of a surrogate pair, which is no text and cannot "
            "be stored. Was it read in another encoding than UTF-8, or cut in the middle of an emoji?"
        )


def check_texts(value: Any, what: str) -> None:
    """Refuse JSON values with a text that could not be stored, in keys too.

    Args:
        value: The JSON values.
        what: What they are, for the message.

    Raises:
        InvalidSetup: A text has half of a surrogate pair.
    """
    if isinstance(value, str):
        check_text(value, f"A text in {what}")
    elif isinstance(value, dict):
        for key, inner in value.items():
            check_text(key, f"A key in {what}")
            check_texts(inner, what)
    elif isinstance(value, list | tuple):
        for inner in value:
            check_texts(inner, what)


def mended_text(text: str) -> str:
    """Return a text that can be stored: with U+FFFD in the place of each half of a surrogate pair."""
    return text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
