#!/bin/sh
# Makes the virtual environment FOLDER with the interpreter PYTHON: sh scripts/make_environment.sh FOLDER [PYTHON]
#
# An environment of the Python that pyproject.toml needs stays as it is; another one, or one whose interpreter does not
# run, is made again. FOLDER/.python is written if the environment is new. Exit status: 0 the environment is there, 2
# PYTHON is not the one needed or cannot make an environment, with one line on stderr.
set -eu
folder=$1
needed=$(sed -n 's/^requires-python = ">=\([0-9.]*\).*/\1/p' pyproject.toml)
python=${2:-python$needed}

refuse() {
    echo "make: $1, and coflight needs Python $needed: type make setup PYTHON=/path/to/python$needed" >&2
    exit 2
}

# prints the version of the interpreter $1, such as 3.11; nothing if it does not run or lacks the module $2
version() {
    "$1" -c "import ${2:-sys}, sys; print('%d.%d' % sys.version_info[:2])" 2>/dev/null || true
}

present=$(version "$folder/bin/python" pip)
if [ "$present" != "$needed" ] || [ -n "${2:-}" ]; then
    found=$(version "$python")
    [ -n "$found" ] || refuse "there is no interpreter $python that runs"
    [ "$found" = "$needed" ] || refuse "$python is Python $found"
fi
if [ "$present" != "$needed" ]; then
    if [ -e "$folder" ]; then
        had=${present:+Python $present, not $needed}
        echo "make: $folder has ${had:-no interpreter that runs and has pip}: it is made again" >&2
        rm -rf "$folder"
    fi
    if ! reason=$("$python" -m venv "$folder" 2>&1); then
        rm -rf "$folder"
        refuse "$python makes no virtual environment ($(echo "$reason" | tr -s '\n' ' '))"
    fi
fi
[ "$present" = "$needed" ] && [ -e "$folder/.python" ] || echo "$needed" >"$folder/.python"
