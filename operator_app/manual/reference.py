"""What the code knows of itself, as pages by topic. Imports what a page needs when it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial


def reference() -> Mapping[str, Callable[[], str]]:
    """Return what makes each page."""
    return {
        **{f"{kind}-file": partial(_file, kind) for kind in FILES},
        **{
            topic: partial(_of_code, topic) for topic in ("exit-codes", "keys", "faults", "objects")
        },
    }


FILES = ("arm", "fixture", "procedure", "profile", "parameters")


def _file(kind: str) -> str:
    from operator_app.manual.file_pages import FILE_KINDS, file_page

    return file_page(next(known for known in FILE_KINDS if known == kind))


def _of_code(topic: str) -> str:
    from operator_app.manual import code_pages

    makes = {
        "exit-codes": code_pages.exit_codes_page,
        "keys": code_pages.keys_page,
        "faults": code_pages.faults_page,
        "objects": code_pages.objects_page,
    }
    return makes[topic]()
