"""Build the wheel, install it elsewhere, fly with it and test the examples, all outside the checkout.

``python scripts/try_wheel.py``. Exit status: 0 if every step succeeds; otherwise that of the failing step.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run(*command: str | Path, cwd: Path) -> None:
    """Run a command in a folder, with this checkout not importable; ends the program if it fails."""
    print("+", *command, flush=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    status = subprocess.run([str(word) for word in command], cwd=cwd, env=environment, check=False).returncode
    if status:
        sys.exit(status)


def main() -> None:
    """Build, install, fly, report, test the examples."""
    with tempfile.TemporaryDirectory(prefix="coflight-wheel-") as name:
        folder = Path(name)
        run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
        (wheel,) = folder.glob("*.whl")
        venv.create(folder / "env", with_pip=True)
        python, coflight = folder / "env" / "bin" / "python", folder / "env" / "bin" / "coflight"
        pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        run(*pip, "--require-hashes", "--requirement", ROOT / "requirements.lock", cwd=folder)
        run(*pip, "--no-index", f"{wheel}[nec2,env]", cwd=folder)  # all that it needs is there
        run(coflight, "scenarios", cwd=folder)
        run(coflight, "fly", "article", "--agents", "8", "--duration", "2", "--out", "run", cwd=folder)
        run(coflight, "report", "run", "--figures", cwd=folder)
        run(coflight, "export", "run", "--time", "17", "--out", "array.nec", cwd=folder)
        print((folder / "array.nec").read_text(encoding="ascii").splitlines()[0])
        tools = ROOT / "requirements-dev.lock"
        run(*pip, "--require-hashes", "--no-deps", "--requirement", tools, cwd=folder)
        for project in sorted(path.parent for path in ROOT.glob("examples/*/pyproject.toml")):
            copy = folder / project.name
            shutil.copytree(project, copy)
            run(*pip, "--no-deps", "--no-build-isolation", copy, cwd=folder)
            run(python, "-m", "pytest", "-q", cwd=copy)


if __name__ == "__main__":
    main()
