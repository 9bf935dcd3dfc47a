# shellcheck shell=bash
# To be sourced: how the scripts of this folder come by the programs of others. Who cannot install says why, and goes on
# without.

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    else
        sudo -n "$@"
    fi
}

# tried COMMAND...: its output is shown where it fails, the end of it.
tried() {
    local log
    log=$(mktemp)
    "$@" >"$log" 2>&1 && rm "$log" && return
    echo "failed: $*" >&2
    tail -n 5 "$log" >&2
    rm "$log"
    return 1
}

# Without a network apt-get and pip try for a long time.
apt_install() {
    tried as_root timeout 120 apt-get update -qq &&
        tried as_root env DEBIAN_FRONTEND=noninteractive timeout 300 apt-get install -y -qq --no-install-recommends "$@"
}

# Ready-made packages for the user's own Python; that of a distribution wants to be asked twice.
pip_install() {
    python3 -m pip --version >/dev/null 2>&1 || apt_install python3-pip || return
    PIP_BREAK_SYSTEM_PACKAGES=1 tried timeout 240 python3 -m pip install --quiet --user --only-binary :all: "$@"
}
