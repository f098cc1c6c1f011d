#!/bin/sh
# Follows every session of a folder with OpenCV's legacy trackers, in an environment of their own:
#   benchmarks/peers/run.sh SESSIONS OUT [track.py's options]
# PEERS_VENV says where that environment is made (default: .venv beside this script), PYTHON which Python makes it.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
venv=${PEERS_VENV:-$here/.venv}
if [ ! -f "$venv/made" ]; then
    "${PYTHON:-python3}" -m venv "$venv"
    pip="$venv/bin/python -m pip install --quiet --disable-pip-version-check"
    $pip -r "$here/requirements.txt"
    $pip --no-deps -e "$here/../.."
    touch "$venv/made"
fi
exec "$venv/bin/python" "$here/track.py" "$@"
