"""Tables as text: columns stay apart at any width, and nothing is lost."""

import re

import pytest
from hypothesis import given, strategies as st

from curricle.text_tables import GAP, or_dash, text_table

HEADS = ("", "steps to threshold", "strong gain", "verdict")
NAMES = st.text("abc -[]>漢", min_size=1, max_size=60).map(str.strip).filter(bool)
ROWS = st.lists(
    st.tuples(
        NAMES,
        st.integers(0, 10**12).map("{:,}".format),
        st.floats(-1e6, 1e6).map("{:.4g} [0.1, 0.2]".format),
        st.sampled_from(["", "pays (p = 0.002)", "too few seeds for a verdict (2; 6 or more)"]),
    ),
    min_size=1,
    max_size=5,
)


@given(rows=ROWS, width=st.integers(40, 200), words=st.booleans())
def test_lines_fit_and_nothing_is_lost(rows, width, words):
    lines = text_table(HEADS, rows, width, words=words)
    assert max(map(len, lines)) <= width
    there = re.sub(r"\s", "", "".join(lines))
    for row in rows:
        assert row[1] in "".join(lines)  # a number is never cut
    assert len(there) >= sum(len(re.sub(r"\s", "", cell)) for row in rows for cell in row)


@given(rows=ROWS)
def test_columns_never_touch(rows):
    lines = text_table(HEADS[:3], [row[:3] for row in rows])
    ends = []
    for line, row in zip(lines[1:], rows, strict=True):
        assert line.endswith(row[2])
        before = line[: -len(row[2])].rstrip()
        assert len(line) - len(row[2]) - len(before) >= GAP
        assert before.endswith(row[1])
        ends.append((len(line), len(before)))
    assert len(set(ends)) == 1  # numbers are aligned to the right


@pytest.mark.parametrize(("value", "text"), [(float("nan"), "-"), (0.0, "0"), (-1.5, "-1.5")])
def test_a_dash_stands_for_no_number(value, text):
    assert or_dash(value) == text
