"""CSV as people and spreadsheets write it says the same as plain CSV, or is refused with a reason."""

from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.spreadsheet import plain_csv

PATH = Path("postures.csv")
NAMES = ["posture", "q.left_knee", "support"]
ROWS = [["1", "0.25", "double"], ["2", "-1.5e-3", "double"], ["3", "7", ""]]
PLAIN = "".join(",".join(row) + "\n" for row in (NAMES, *ROWS)).encode()


@given(
    separator=st.sampled_from([",", ";"]),
    comma=st.booleans(),
    spaces=st.integers(0, 3),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    mark=st.booleans(),
    quoted=st.booleans(),
    columns=st.integers(0, 2),
    between=st.lists(
        st.tuples(st.integers(0, 4), st.sampled_from(["", "   ", "# note; 1,5", '"# quoted, note",,'])),
        max_size=5,
    ),
    last=st.booleans(),
    top=st.sampled_from(["", "sep=", "SEP="]),
)
@settings(max_examples=200, deadline=None)
def test_every_spelling_means_the_same(
    separator, comma, spaces, end, mark, quoted, columns, between, last, top
):
    def value(text):
        text = text.replace(".", ",") if comma and separator == ";" and text not in NAMES else text
        return " " * spaces + (f'"{text}"' if quoted else text) + " " * spaces

    lines = [separator.join([*map(value, row), *[""] * columns]) for row in (NAMES, *ROWS)]
    for at, extra in between:
        lines.insert(at, extra if extra.strip() else separator * (columns + 2))
    if top:
        lines.insert(0, top + separator)
    text = end.join(lines) + (end if last else "")
    assert plain_csv(PATH, (b"\xef\xbb\xbf" if mark else b"") + text.encode()) == PLAIN


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no line with column names"),
        (b"# nothing\n\n,,\n", "no line with column names"),
        (PLAIN + b"4,1\n", "line 5: found 2 values, expected 3"),
        (PLAIN + b"4,1,double,9\n", "line 5: found 4 values, expected 3"),
        (b"# one\n\n" + PLAIN + b"4,0,25,double\n", "line 7: found 4 values, expected 3"),
        ("posture,q\n1,\u00bd\n".encode("latin-1"), "byte 12 is not UTF-8; save it as 'CSV UTF-8'"),
        ("posture,q\n1,2\n".encode("utf-16"), "byte 0 is not UTF-8"),
        (b"posture;q.a;q.b\n1;0,5;0.5\n", "found both 0,5 and 0.5, expected one decimal sign"),
        (b'posture,q\n1,"2\n3"\n', "spans two lines"),
        (b'posture,q\n1,"2\n', "not a CSV file"),
        (b'posture,q\n1,"2"3\n', "not a CSV file"),
    ],
)
def test_what_could_mean_two_things_is_refused(content, message):
    with pytest.raises(InputError, match=message):
        plain_csv(PATH, content)


@example(b"\x00\r\x0b")  # a line of one vertical tab is empty
@example(b'";",a\n1,2\n')  # a name that separates
@example(b"\t#")  # so is a comment behind a tab
@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_any_bytes_are_read_or_refused(content):
    try:
        again = plain_csv(PATH, content)
    except InputError:
        return
    assert plain_csv(PATH, again) == again
