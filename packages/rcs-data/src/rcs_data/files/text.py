"""Checks that text can be stored: Python strings may hold half surrogate pairs, which UTF-8 cannot encode."""

from __future__ import annotations

from typing import Any

from rcs_data.errors import InvalidSetup


def is_storable(text: str) -> bool:
    """Return whether a text can be written as UTF-8."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def check_text(text: object, what: str) -> None:
    """Refuse a value that is not text or cannot be stored; `what` begins the message, such as "The instruction".

    Half surrogate pairs come from command-line arguments that are not UTF-8, or from an emoji cut in two.

    Raises:
        InvalidSetup: It is not text, or has half a surrogate pair.
    """
    if not isinstance(text, str):
        raise InvalidSetup(f"{what} must be text, not {type(text).__name__}.")
    if not is_storable(text):
        place = next(i for i, letter in enumerate(text) if "\ud800" <= letter <= "\udfff")
        raise InvalidSetup(
            f"{what} is {text!r}, and its character {place} is half a surrogate pair, which cannot "
            "be stored. Was it read in another encoding than UTF-8, or cut in the middle of an emoji?"
        )


def check_texts(value: Any, what: str) -> None:
    """Refuse JSON values whose texts or keys cannot be stored; the message says what they are.

    Raises:
        InvalidSetup: A text has half a surrogate pair.
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
    """Return the text with U+FFFD in place of each half surrogate pair."""
    return text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
