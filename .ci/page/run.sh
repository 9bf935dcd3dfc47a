#!/usr/bin/env bash
# The page of a commission in headless Chromium.
#
#   .ci/page/run.sh PROGRAM
#
# Installs Chromium, its driver and selenium where they are missing. Where that is impossible (no network, not root) it says
# aloud that nothing was checked, and ends well; with DRIVEBENCH_REQUIRE_PAGE=1 it fails.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=.ci/install.sh
. "$here/../install.sh"
program=$(realpath "${1:?usage: run.sh PROGRAM}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

missing() {
    for tool in chromium chromedriver; do
        command -v "$tool" >/dev/null || echo "$tool"
    done
    python3 -c 'import venv, ensurepip' 2>/dev/null || echo python3-venv
}

install_browser() {
    if [ -n "$(missing)" ]; then
        apt_install chromium chromium-driver fonts-dejavu-core python3-venv || return
    fi
    [ -z "$(missing)" ] || return 1
    python3 -m venv "$work/venv"
    tried timeout 180 "$work/venv/bin/pip" install -q --disable-pip-version-check 'selenium==4.51.0'
}

if ! install_browser; then
    echo "the browser cannot be installed here: $(missing | tr '\n' ' ')" >&2
    if [ "${DRIVEBENCH_REQUIRE_PAGE:-0}" = 1 ]; then
        echo "help: install it, or unset DRIVEBENCH_REQUIRE_PAGE to go on without" >&2
        exit 1
    fi
    echo "the page is NOT checked in a browser" >&2
    exit 0
fi

"$program" commission --headless --port sim: --out "$work/runs" >/dev/null 2>"$work/commission.log" || {
    cat "$work/commission.log" >&2
    exit 1
}
fit=$(find "$work/runs" -maxdepth 1 -name '*-fit' | head -n 1)
"$work/venv/bin/python" "$here/check.py" "$fit" ${DRIVEBENCH_PAGES:+"$DRIVEBENCH_PAGES"}
