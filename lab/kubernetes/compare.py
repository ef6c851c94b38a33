"""Compares schemas.yaml with what upstream publishes: files of custom resource definitions (CRDs), which you download.

Usage: python3 -m lab.kubernetes.compare FILE...

Prints what our schemas allow and a CRD refuses. The exit code is 0 if there is nothing of the kind. Ours may refuse more:
they list only the fields in use. Needs the packages of lab/kubernetes/requirements.txt, and no network.
"""

import operator
import re
import sys
from collections.abc import Callable, Iterator
from itertools import chain, product
from pathlib import Path
from typing import Any

import yaml

from .manifests import Object
from .schemas import SCHEMAS, Validator

# Ours may be equal to theirs, or stricter in the direction of the function.
BOUNDS: dict[str, Callable[[Any, Any], bool]] = {
    **dict.fromkeys(("minimum", "minLength", "minItems", "minProperties"), operator.ge),
    **dict.fromkeys(("maximum", "maxLength", "maxItems", "maxProperties"), operator.le),
}
FORMATS = {"int32": {"minimum": -(2**31), "maximum": 2**31 - 1}, "int64": {"minimum": -(2**63), "maximum": 2**63 - 1}}
# What does not say whether a value is valid.
SILENT = {"description", "default", "title", "example", "x-kubernetes-map-type", "x-kubernetes-list-type"}
COMPARED = {"type", "anyOf", "format", "enum", "pattern", "required", "properties", "items", "additionalProperties"}
COMPARED |= {f"x-kubernetes-{key}" for key in ("int-or-string", "list-map-keys", "validations")}
KNOWN = SILENT | set(BOUNDS) | COMPARED
# Checked by the schemas of Kubernetes, in `invalid`.
ELSEWHERE = ("metadata", "spec.replicatedJobs[].template.spec")
# Rules that no schema can express, by their messages, about fields that ours do not have.
UNCOMPARED = {"StartupPolicy and DependsOn APIs are mutually exclusive"}
# Strings up to this length are tried where two patterns differ.
N_TRIED = 4


def laxer(ours: Object, theirs: Object, path: str = "") -> Iterator[str]:
    """Yields where `ours` allows what `theirs` refuses, and what this comparison does not understand."""
    if path in ELSEWHERE:
        return
    where = path or "the object"
    yield from (f"{where}: unknown to this comparison: {key}" for key in sorted(set(theirs) - KNOWN))
    for rule in theirs.get("x-kubernetes-validations", []):
        # Those with `oldSelf` compare a change with what was there.
        if "oldSelf" not in rule["rule"] and rule.get("message") not in UNCOMPARED:
            yield f"{where}: a rule to judge by hand: {rule['rule']}"
    if values := [ours["const"]] if "const" in ours else ours.get("enum"):
        errors = chain.from_iterable(Validator(theirs).iter_errors(value) for value in values)
        yield from (f"{where}: {error.message}" for error in errors)
        return
    if ours.get("type") not in (types := accepted(theirs)):
        yield f"{where}: is {ours.get('type')}, not one of {types}"
    if "enum" in theirs:
        yield f"{where}: is not one of {theirs['enum']}"
    if "pattern" in theirs and (text := escaping(ours.get("pattern", ""), theirs["pattern"])) is not None:
        yield f"{where}: {text!r} does not match {theirs['pattern']}"
    yield from (f"{where}: {complaint}" for complaint in unbounded(ours, theirs))
    missing = sorted(set(theirs.get("required", [])) - set(ours.get("required", [])))
    yield from (f"{where}: {key} is not required" for key in missing)
    yield from inside(ours, theirs, path)


def inside(ours: Object, theirs: Object, path: str) -> Iterator[str]:
    """Yields what `laxer` finds in properties and items, and where ours has no such limits."""
    for key, part in ours.get("properties", {}).items():
        below = f"{path}.{key}".lstrip(".")
        found = theirs.get("properties", {}).get(key, theirs.get("additionalProperties"))
        yield from laxer(part, found, below) if isinstance(found, dict) else [f"{below}: there is no such field"]
    if "properties" in theirs and ours.get("additionalProperties") is not False:
        yield f"{path}: may have any field"
    for key, mark in (("items", "[]"), ("additionalProperties", ".*")):
        if isinstance(theirs.get(key), dict) and ours.get(key) is not False:
            part = ours.get(key)
            yield from laxer(part, theirs[key], path + mark) if isinstance(part, dict) else [f"{path}{mark}: may be anything"]
    keys = theirs.get("x-kubernetes-list-map-keys")
    if keys and keys != ours.get("x-kubernetes-list-map-keys"):
        yield f"{path}: items may be equal in {keys}"


def accepted(schema: Object) -> list[str]:
    """Returns the types that a schema allows."""
    return [schema["type"]] if "type" in schema else [part["type"] for part in schema.get("anyOf", [])]


def unbounded(ours: Object, theirs: Object) -> Iterator[str]:
    """Yields the bounds of theirs, those of its format included, that ours lacks or passes."""
    form = theirs.get("format", "")
    bounds = FORMATS.get(form, {}) | {key: theirs[key] for key in BOUNDS if key in theirs}
    if form and form not in FORMATS:
        yield f"unknown to this comparison: the format {form}"
    for key, bound in bounds.items():
        if key not in ours or not BOUNDS[key](ours[key], bound):
            yield f"{key} is not {bound}"


def escaping(ours: str, theirs: str) -> str | None:
    """Returns a short string that matches our pattern and not theirs, or None if there is none."""
    if ours == theirs:
        return None
    alphabet = sorted({*re.sub(r"\W", "", ours + theirs), *" -."})
    texts = ("".join(letters) for n in range(N_TRIED + 1) for letters in product(alphabet, repeat=n))
    return next((text for text in texts if re.search(ours, text) and not re.search(theirs, text)), None)


def main(paths: list[str]) -> int:
    """Compares the schema of each file, and returns the exit code."""
    complaints = []
    for path in paths:
        for crd in yaml.safe_load_all(Path(path).read_text()):
            kind, group = crd["spec"]["names"]["kind"], crd["spec"]["group"]
            ours = SCHEMAS[kind]
            schemas = {f"{group}/{version['name']}": version["schema"] for version in crd["spec"]["versions"]}
            version = ours["properties"]["apiVersion"]["const"]
            found = list(laxer(ours, schemas[version]["openAPIV3Schema"])) if version in schemas else [f"no {version}"]
            complaints += [f"{kind}: {complaint}" for complaint in found]
            print(f"{kind}: {len(found)} differences from {version} in {path}")
    print("\n".join(complaints) or "nothing is laxer")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) if sys.argv[1:] else __doc__)
