"""Digests of contents: of texts, however they are stored."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from shapefit.io.contents import ValuesDigest

TEXTS = st.lists(st.binary(max_size=6).map(lambda text: text.rstrip(b"\0")), min_size=1)


def digest(values):
    found = ValuesDigest()
    found.add(values)
    return found.hexdigest()


@given(TEXTS)
@example([b""])
@example([b"a\0b", b"", b"abcdef"])
def test_texts_of_one_width_have_the_digest_of_texts_of_any_length(texts):
    any_length = np.array(texts, object)
    one_width = np.array(texts, np.bytes_)
    assert digest(one_width) == digest(any_length)


@given(TEXTS)
def test_the_width_does_not_count(texts):
    wide = np.array(texts, "S9")
    assert digest(wide) == digest(np.array(texts, object))


def test_where_one_text_ends_and_the_next_begins_counts():
    assert digest(np.array([b"ab", b"c"])) != digest(np.array([b"a", b"bc"]))
