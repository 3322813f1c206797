"""Report words that are kept for people: ``python scripts/lint_prose.py [PATH ...]``. Status: 0 none, 1 some.

Programs, files and numbers do not hear, know or want; docs/how-to/contribute.md has the rule and the plain
words. All tracked text files are checked without arguments; a justified exception is a line of `EXCEPTIONS`.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SUFFIXES = {".py", ".md", ".toml"}
WORDS = re.compile(
    r"\b(who|whom|whoever|(?:no|some|every|any)body|no one|someone|anyone|everyone|anew"
    r"|in one go|lets? go|as they do|hear(?:s|d|ing)?"
    r"|tells?|telling|told|know|knows|knew|wants?|wanted|go(?:es)? home|gives? way)\b",
    re.IGNORECASE,
)
EXCEPTIONS: dict[str, str] = {
    "scripts/lint_prose.py": "holds the list itself",
}
"""Files that are not checked, with the reason; at most ten."""


def tracked() -> list[Path]:
    """Return the paths of all tracked files of the checkout."""
    git = shutil.which("git") or "git"
    listed = subprocess.run([git, "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in listed.stdout.split("\0") if name]


def findings(path: Path) -> list[str]:
    """Return one line ``path:line: 'word'`` for each word in a file that is kept for people."""
    name = path.resolve().relative_to(ROOT).as_posix()
    if path.suffix not in SUFFIXES or name in EXCEPTIONS:
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    return [
        f"{name}:{number}: {match.group(0)!r}"
        for number, line in enumerate(lines, 1)
        for match in WORDS.finditer(line)
    ]


def main(arguments: list[str]) -> int:
    """Check the files or folders that are named, or all tracked ones."""
    named = [Path(argument) for argument in arguments]
    paths = [file for path in named for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    found = [line for path in paths or tracked() if path.is_file() for line in findings(path)]
    for line in found:
        print(line)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
