#!/usr/bin/env bash
# A new user's first hour, timed: README and tutorial word for word, each in a fresh clone, with an
# empty HOME and nothing cached. It fails where a step fails, prints something else than its page
# has, or takes longer than its page states. Without a page it also times the first study from its
# file to its report, cold and warm, which fails beyond twice the seconds that are aimed at.
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
    PATH=$place/$name-venv/bin:$PATH "$python" "$repository/tests/support/walk.py" \
        "$place/$name/$page" --folder "$place/$name" || failed=1
    echo "$page: $((SECONDS - began)) s in all"
done

SLOWER=2  # a shared machine may take so many times the aim
timed() {  # timed AIM NAME COMMAND...
    local aim=$1 name=$2 began
    shift 2
    began=$(date +%s%3N)
    (cd "$place/first" && PATH=$place/first-venv/bin:$PATH bash -euc "$*" >/dev/null 2>&1) || failed=1
    local took=$(($(date +%s%3N) - began))
    echo "$name: $took ms, aim $aim ms"
    [ $took -le $((SLOWER * aim)) ] || failed=1
}
if [ $# -eq 0 ]; then
    git clone -q "$repository" "$place/source"
    mkdir "$place/first"
    "$python" -m venv "$place/first-venv"
    "$place/first-venv/bin/python" -m pip install -q "$place/source"
    study="curricle new pursuit; curricle check pursuit.toml; curricle run pursuit.toml"
    study+="; curricle show pursuit-results; curricle report pursuit-results"
    timed 15000 "the first study, nothing compiled" "$study"
    timed 7000 "the same again" "rm -r pursuit*; $study"
    timed 200 "curricle --help" "curricle --help"
    timed 300 "import curricle" "python -c 'import curricle'"
fi
exit $failed
