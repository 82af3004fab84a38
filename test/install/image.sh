#!/bin/sh
# Makes the image of rel/container/Containerfile and runs it, and both services of compose.yaml, without a container engine. Needs root.
#
#   debootstrap --variant=minbase trixie /var/tmp/bare
#   bin/release
#   test/install/image.sh /var/tmp/bare [FOLDER]       # FOLDER: bin/release's --output, by default _build/release
#
# The steps are done in copies of the bare root, in namespaces of their own: no process, port or file of it is left.
set -eu
[ $# -ge 1 ] && [ -x "$1/usr/bin/dpkg" ] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
here=$(cd "$(dirname "$0")/../.." && pwd -P)
made=${2:-$here/_build/release}
work=$(mktemp -d -p "${TMPDIR:-/var/tmp}")
trap 'rm -rf --one-file-system "$work"' EXIT
# All processes end with the first one.
PATH=$here/.toolchain/bin:$PATH unshare --mount --pid --mount-proc --fork --kill-child elixir "$here/test/install/image.exs" "$1" "$made" "$work" &
all=$!
trap 'kill -KILL $all; wait $all; exit 143' INT TERM
wait $all
