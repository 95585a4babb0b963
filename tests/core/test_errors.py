"""Messages and errors keep the template and the values that they were made from."""

import copy
import pickle

import pytest

from facemime.core.base.errors import DataError, FacemimeError, Message, SourceError, messages


def test_a_message_is_its_text():
    message = Message("{path!r} has {share:.1f} %.", path="a.csv", share=2.25)
    assert message == "'a.csv' has 2.2 %." and f"{message}" == message and isinstance(str(message), Message)
    assert message.template == "{path!r} has {share:.1f} %." and message.values == {"path": "a.csv", "share": 2.25}


def test_a_text_without_values_is_not_formatted():
    assert Message("Use {name} as a placeholder.") == "Use {name} as a placeholder."


def test_a_message_is_made_only_once():
    message = Message("{count} rows", count=2)
    assert Message(message) is message and str(SourceError(message)) is message


@pytest.mark.parametrize("error", [FacemimeError, SourceError, DataError])
def test_the_text_of_an_error_is_a_message(error):
    text = str(error("row {number} is empty", number=3))
    assert text == "row 3 is empty" and isinstance(text, Message) and text.values == {"number": 3}


def test_an_error_within_a_message_stands_for_its_message():
    reason = DataError("{name} is missing", name="shape")
    within = Message("It is damaged ({error}).", error=reason).values["error"]
    assert within == "shape is missing" and within.template == "{name} is missing"
    assert Message("It is damaged ({error}).", error=OSError("disk")).values == {"error": "disk"}


@pytest.mark.parametrize("again", [copy.deepcopy, lambda error: pickle.loads(pickle.dumps(error))])
def test_an_error_keeps_its_message_in_copies_and_other_processes(again):
    error = SourceError("{path}: {error}", path="a.csv", error=DataError("it has {count} rows", count=0))
    text = str(again(error))
    assert text == "a.csv: it has 0 rows" and text.template == "{path}: {error}"
    assert text.values["error"].values == {"count": 0}


def test_a_text_of_a_file_is_read_as_the_message_it_was():
    template = "was off by {error} % in frame {frame} (once)"
    message = Message.read("was off by 1.25 % in frame 7 (once)", template)
    assert message.template == template and message.values == {"error": "1.25", "frame": "7"}
    assert Message.read("mentalis", template).template == "mentalis"


def test_a_table_of_texts_is_one_of_messages():
    assert {key: text.template for key, text in messages({8: "Chin"}).items()} == {8: "Chin"}
