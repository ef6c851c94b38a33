#!/bin/sh
# Installs the program of the release that this script is part of.
#
#   curl -LsSf @ADDRESS@/install.sh | sh                            # into ~/.local/bin
#   curl -LsSf @ADDRESS@/install.sh | sh -s -- /usr/local/bin
set -eu

fail() {
    echo "install.sh: $1" >&2
    exit 1
}

folder=${1:-$HOME/.local/bin}
[ "$(uname -s)" = Linux ] || fail "a release has programs for Linux only; build one with \`cargo build --release\`"
case $(uname -m) in
x86_64 | aarch64) name=lodestone-$(uname -m)-linux ;;
*) fail "a release has no program for $(uname -m); build one with \`cargo build --release\`" ;;
esac
command -v curl >/dev/null || fail "curl is not installed"

scratch=$(mktemp -d)
trap 'rm -r "$scratch"' EXIT
for file in "$name.tar.gz" "$name.tar.gz.sha256"; do
    curl -LsSf -o "$scratch/$file" "@ADDRESS@/$file" || fail "cannot fetch @ADDRESS@/$file"
done
(cd "$scratch" && sha256sum --check --status "$name.tar.gz.sha256") || fail "$name.tar.gz is damaged: try again"
tar -xzf "$scratch/$name.tar.gz" -C "$scratch"
mkdir -p "$folder"
install -m 755 "$scratch/$name/lodestone" "$folder/lodestone"
"$folder/lodestone" --version
case ":$PATH:" in
*":$folder:"*) ;;
*) echo "$folder is not on your PATH: add it, or call $folder/lodestone" ;;
esac
