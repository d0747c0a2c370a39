#!/usr/bin/env bash
# A new user's first hour, timed: README and tutorial word for word, each in a fresh clone, with an
# empty HOME and nothing cached. It fails where a step fails, prints something else than its page
# has, or takes longer than its page states.
#
#     tests/first_hour.sh [PAGE ...]        (make first-hour; PYTHON=python3.12 chooses another)
set -euo pipefail
repository=$(cd "$(dirname "$0")/.." && pwd)
python=$(command -v "${PYTHON:-python3}")
pages=("${@:-README.md}")
[ $# -gt 0 ] || pages+=(docs/tutorial.md)

place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
export HOME=$place/home TMPDIR=$place/tmp COLUMNS=80
mkdir "$HOME" "$TMPDIR"
unset VIRTUAL_ENV PYTHONPATH NUMBA_CACHE_DIR XDG_CACHE_HOME XDG_CONFIG_HOME

failed=0
for page in "${pages[@]}"; do
    name=$(basename "$page" .md)
    git clone -q "$repository" "$place/$name"
    # What the README takes for granted; the tutorial makes one itself.
    "$python" -m venv "$place/$name-venv"
    began=$SECONDS
    PATH=$place/$name-venv/bin:$PATH "$python" "$repository/tests/walk.py" \
        "$place/$name/$page" --folder "$place/$name" || failed=1
    echo "$page: $((SECONDS - began)) s in all"
done
exit $failed
