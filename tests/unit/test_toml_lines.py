"""Lines of keys in TOML, whatever stands in comments and strings."""

import textwrap
import tomllib

import pytest

from curricle.study.file import line_numbers


def lines(text):
    text = textwrap.dedent(text)
    tomllib.loads(text)  # valid, as it is when lines are asked for
    return line_numbers(text)


def test_lines_of_tables_keys_and_entries():
    assert lines(
        """\
        name = "x" # size = 3
        [tasks."5 x 5"]
        map = '''
        size = 4
        [nothing]
        '''
        rewards.step = 1
        learner = { epsilon = 1, "a.b" = { c = 1.5 } }
        [[transfers]]
        scale = 1
        [[transfers]]

          scale = 2
        [transfers.project]
        row = "column"
        """
    ) == {
        ("name",): 1,
        ("tasks",): 2,
        ("tasks", "5 x 5"): 2,
        ("tasks", "5 x 5", "map"): 3,
        ("tasks", "5 x 5", "rewards"): 7,
        ("tasks", "5 x 5", "rewards", "step"): 7,
        ("tasks", "5 x 5", "learner"): 8,
        ("tasks", "5 x 5", "learner", "epsilon"): 8,
        ("tasks", "5 x 5", "learner", "a.b"): 8,
        ("tasks", "5 x 5", "learner", "a.b", "c"): 8,
        ("transfers",): 9,
        ("transfers", 0): 9,
        ("transfers", 0, "scale"): 10,
        ("transfers", 1): 11,
        ("transfers", 1, "scale"): 13,
        ("transfers", 1, "project"): 14,
        ("transfers", 1, "project", "row"): 15,
    }


@pytest.mark.parametrize(
    "first",
    [
        "a = 1 # drawn in '''",
        'a = 1 # or """',
        "a = \"'''\"",
        'a = \'"""\'',
        'a = "# no comment"',
        'a = "\\"# still inside"',
        "a = '''one line'''",
        'a = """"quoted""""',
        "a = [1, 2] # [",
        "# '''",
    ],
)
def test_quotes_in_comments_and_strings_hide_no_key(first):
    assert lines(f"{first}\nb = 2\n")[("b",)] == 2


def test_keys_after_strings_and_lists_of_several_lines():
    found = lines(
        '''\
        a = """
        b = 1
        \\""" c = 1
        """
        list = [
          { d = 1 }, # ]
          "e = 1",
        ]
        f.g = 2024-01-01T00:00:00.5
        h = 1.5
        '''
    )
    assert found == {
        ("a",): 1,
        ("list",): 5,
        ("list", 0): 6,
        ("list", 0, "d"): 6,
        ("list", 1): 7,
        ("f",): 9,
        ("f", "g"): 9,
        ("h",): 10,
    }
