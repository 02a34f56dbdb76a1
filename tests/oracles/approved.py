"""Approval test of the product's sentences, which are in tests/approved_words.json and in no test.

`pytest --approve PATHS` writes the present sentences; check the file's difference.
"""

import fcntl
import json
from pathlib import Path

FILE = Path(__file__).resolve().parents[1] / "approved_words.json"


class Approve:
    """Sentences of one test, by its name, and from the second call on by name and number.

    Its temporary `folder` is written as `$TMP`; line breaks are ignored.
    """

    def __init__(self, name: str, *, folder: Path, write: bool) -> None:
        self._name, self._folder, self._write, self._calls = name, folder, write, 0

    def __call__(self, text: str) -> None:
        self._calls += 1
        text = " ".join(text.replace(str(self._folder), "$TMP").split())
        key = self._name if self._calls == 1 else f"{self._name} #{self._calls}"
        with FILE.open("r+" if self._write else "r", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX if self._write else fcntl.LOCK_SH)
            approved: dict[str, str] = json.load(file)
            if self._write and approved.get(key) != text:
                approved[key] = text
                file.seek(0)
                file.truncate()
                json.dump(approved, file, indent=1, sort_keys=True, ensure_ascii=False)
                file.write("\n")
        assert text == approved.get(key), "not as approved: run pytest --approve, and check"
