"""The product's sentences that tests look at stand in one file, and in no test: tests/approved_words.json.

`pytest --approve PATHS` writes what is said now; the file's difference is what a reader looks at.
"""

import fcntl
import json
from pathlib import Path

FILE = Path(__file__).resolve().parents[1] / "approved_words.json"


class Approve:
    """What one test was told, by the test's name; called a second time, by name and number.

    Its temporary `folder` is written as `$TMP`; how lines are broken does not count.
    """

    def __init__(self, name: str, *, folder: Path, write: bool) -> None:
        self._name, self._folder, self._write, self._calls = name, folder, write, 0

    def __call__(self, said: str) -> None:
        """Hold a sentence to the approved one."""
        self._calls += 1
        said = " ".join(said.replace(str(self._folder), "$TMP").split())
        key = self._name if self._calls == 1 else f"{self._name} #{self._calls}"
        with FILE.open("r+" if self._write else "r", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX if self._write else fcntl.LOCK_SH)
            approved: dict[str, str] = json.load(file)
            if self._write and approved.get(key) != said:
                approved[key] = said
                file.seek(0)
                file.truncate()
                json.dump(approved, file, indent=1, sort_keys=True, ensure_ascii=False)
                file.write("\n")
        assert said == approved.get(key), "other words than approved: pytest --approve, and look"
