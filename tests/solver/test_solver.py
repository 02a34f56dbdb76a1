"""The index in the docstring of `solver`: every name exists, every equation of the paper is listed."""

import re
from pkgutil import resolve_name

import solver


def test_names_in_the_docstring_exist():
    names = re.findall(r"solver(?:\.\w+)+", solver.__doc__ or "")
    assert len(names) >= 15
    for name in names:
        assert callable(resolve_name(name)), name


def test_docstring_lists_every_equation_of_the_paper():
    numbers = re.findall(r"^ +eqs?\. ([\d, ]+)", solver.__doc__ or "", flags=re.MULTILINE)
    assert sorted(int(n) for text in numbers for n in text.split(",")) == list(range(1, 16))
