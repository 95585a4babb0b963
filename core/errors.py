"""Messages, which can be translated, and errors that a user can cause: they say what happened and what to do."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, TypeVar

_Key = TypeVar("_Key")


class Message(str):
    """A text for the user in English, with the template and the values that it was made from.

    Parameters
    ----------
    template : str
        With the name of each value in braces, as in `str.format`. A message is returned as it is.
    values : object
        Values that are messages are translated as well; other texts are names. An error stands for its message.
    """

    template: str
    values: dict[str, Any]

    def __new__(cls, template: str, /, **values: Any) -> Message:
        """Format the template; without values, it is the text."""
        if isinstance(template, cls):
            return template
        # An error would keep its traceback alive, and may not be able to cross to another process.
        values = {name: str(value) if isinstance(value, BaseException) else value for name, value in values.items()}
        message = super().__new__(cls, template.format(**values) if values else template)
        message.template, message.values = template, values
        return message

    def __getnewargs_ex__(self) -> tuple[tuple[str], dict[str, Any]]:
        """Return what a copy or pickle is made from."""
        return (self.template,), self.values

    def __str__(self) -> str:
        """Return the message itself, so that `str(error)` can be translated."""
        return self

    @classmethod
    def read(cls, text: str, *templates: str) -> Message:
        """Return a message that a file contains as a text: one of the first template that fits, or a constant."""
        for template in templates:
            pattern = re.sub(r"\\{(\w+)\\}", r"(?P<\1>.*)", re.escape(template))
            if (match := re.fullmatch(pattern, text)) is not None:
                return cls(template, **match.groupdict())
        return cls(text)


def messages(texts: Mapping[_Key, str]) -> dict[_Key, Message]:
    """Return a table of texts for the user as messages, so that they can be translated."""
    return {key: Message(text) for key, text in texts.items()}


class FacemimeError(Exception):
    """Base class of expected errors, which are shown as a message without a traceback. Made like a `Message`."""

    def __init__(self, template: str, /, **values: Any) -> None:
        super().__init__(Message(template, **values))


class SourceError(FacemimeError):
    """A camera, video, image or take cannot be read."""


class ModelError(FacemimeError):
    """A file of the assets is missing, damaged, of a different version, or not one of Facemime's."""


class HeadError(FacemimeError):
    """A mesh cannot be driven: it lacks landmarks, regions, or enough distinct control points."""


class OutputError(FacemimeError):
    """A result cannot be written to the requested location."""


class DataError(ValueError):
    """Data, such as a file's, cannot be used: a reason, for the message of another error. Made like a `Message`."""

    def __init__(self, template: str, /, **values: Any) -> None:
        super().__init__(Message(template, **values))
