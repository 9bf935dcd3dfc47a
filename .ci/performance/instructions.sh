#!/usr/bin/env bash
# Counts the instructions of every hot path with valgrind and compares them with those written down: a machine may be slow, but
# it does not count wrongly. More than 5 % above what stands in instructions.txt fails.
#
#   .ci/performance/instructions.sh [--write]
#
# Counts are of one compiler: with another they are shown and not judged. What start and set-up cost falls out of the
# difference between doing the work once and four times.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=.ci/install.sh
. "$here/../install.sh"
most_percent=5
written=$here/instructions.txt
if ! command -v valgrind >/dev/null && ! apt_install valgrind; then
    echo 'not checked: valgrind could not be installed'
    exit 0
fi
kernel=$("$here/kernel.sh")
compiler=$(rustc --version)
counted() {
    local said count
    said=$(valgrind --tool=cachegrind --cache-sim=no --cachegrind-out-file=/dev/null "$kernel" "$1" "$2" 2>&1 >/dev/null)
    count=$(sed -n 's/.*I *refs: *//p' <<<"$said" | tr -d ,)
    if [ -z "$count" ]; then
        echo "error: valgrind counted nothing of $1:" >&2
        tail -n 5 <<<"$said" >&2
        return 1
    fi
    echo "$count"
}
counts=$(mktemp)
trap 'rm -f "$counts" "$counts.once"' EXIT
"$kernel" | while read -r id elements; do
    # Beside each other: a count does not depend on the time it takes.
    counted "$id" 1 >"$counts.once" &
    often=$(counted "$id" 4)
    wait $!
    once=$(<"$counts.once")
    echo "$id $(((often - once) / 3 / elements))"
done >"$counts"
if [ "${1:-}" = --write ]; then
    { echo "# Instructions of one element of each hot path, by $compiler; instructions.sh --write writes them anew."; cat "$counts"; } >"$written"
    cat "$written"
    exit 0
fi
if [ ! -f "$written" ]; then
    echo "error: $written is not there; instructions.sh --write makes it" >&2
    exit 1
fi
judged=yes
grep -qF "by $compiler;" "$written" || judged=no
failed=0
while read -r id count; do
    before=$(sed -n "s|^$id ||p" "$written")
    if [ -z "$before" ]; then
        echo "FAIL $id: $count instructions, and none are written down"
        failed=1
    elif ((count * 100 > before * (100 + most_percent))); then
        echo "$([ $judged = yes ] && echo FAIL || echo more) $id: $count instructions, $before are written down"
        [ $judged = no ] || failed=1
    elif ((count * (100 + most_percent) < before * 100)); then
        echo "less $id: $count instructions, $before are written down: write the gain down"
    else
        echo "ok   $id: $count instructions"
    fi
done <"$counts"
while read -r id _; do
    if [ "$id" != '#' ] && ! grep -q "^$id " "$counts"; then
        echo "FAIL $id: written down, and not counted any more"
        failed=1
    fi
done <"$written"
[ $judged = yes ] || echo "not judged: they were counted by another compiler than $compiler"
if [ $failed = 1 ]; then
    echo 'help: find what became slower, or say in the commit why it must, with .ci/performance/instructions.sh --write' >&2
    exit 1
fi
