#!/usr/bin/env bash
# Prints the Secrets of a run, one per role folder from `lodestone keys new` and one for the page's token:
#
#     deploy/kubernetes/secrets.sh KEYS [NAMESPACE] | kubectl apply --server-side -f -
#
# The CA's private key and the folders of roles that run elsewhere are not included. The token is generated once and
# kept in KEYS/page-token. This script sends nothing anywhere.
set -euo pipefail

fail() {
    printf 'secrets.sh: %s\n' "$1" >&2
    exit 2
}

[[ $# -eq 1 || $# -eq 2 ]] || fail "usage: secrets.sh KEYS [NAMESPACE]"
keys=$1
namespace=${2:-lodestone}
kubectl=${KUBECTL:-kubectl}
command -v "$kubectl" >/dev/null || fail "$kubectl is not installed; it writes the Secrets, and needs no cluster for that"

# Lists the files of a role. They are named explicitly so that no other file in the folder is included.
files_of() {
    echo ca.pem cert.pem key.pem password
    [[ $1 != router ]] || echo users
}

# Check all files before printing anything, because kubectl would apply a partial set of Secrets.
for role in router learner actor evaluator; do
    for file in $(files_of "$role"); do
        [[ -r $keys/$role/$file ]] || fail "cannot read $keys/$role/$file: make the keys with \`lodestone keys new $keys --host router\`"
    done
done

# The prefix keeps a token of digits from being parsed as a number.
if [[ ! -e $keys/page-token ]]; then
    (umask 077 && printf 'page-%s' "$(od -An -N16 -tx1 /dev/urandom | tr -d ' \n')" >"$keys/page-token")
fi

secret() {
    printf -- '---\n'
    "$kubectl" create secret generic "$@" --namespace "$namespace" --dry-run=client --output yaml
}

for role in router learner actor evaluator; do
    arguments=()
    for file in $(files_of "$role"); do
        arguments+=("--from-file=$keys/$role/$file")
    done
    secret "keys-$role" "${arguments[@]}"
done
secret evaluator-page "--from-file=token=$keys/page-token"
