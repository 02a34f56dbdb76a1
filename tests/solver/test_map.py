"""The map at the head of `solver`: every place it names is there."""

import re
from importlib import import_module

import solver


def named() -> list[str]:
    return re.findall(r"solver(?:\.\w+)+", solver.__doc__ or "")


def test_every_place_on_the_map_exists():
    places = named()
    assert len(places) >= 15
    for place in places:
        module, rest = place.split("."), list[str]()
        while True:
            try:
                found = import_module(".".join(module))
                break
            except ModuleNotFoundError:
                module, rest = module[:-1], [module[-1], *rest]
        for name in rest:
            found = getattr(found, name)
        assert callable(found), place


def test_every_equation_of_the_paper_is_on_the_map():
    numbers = re.findall(r"^ +eqs?\. ([\d, ]+)", solver.__doc__ or "", flags=re.MULTILINE)
    assert sorted(int(n) for text in numbers for n in text.split(",")) == list(range(1, 16))
