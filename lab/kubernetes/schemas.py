"""Validates objects: Kubernetes' own by its schemas, custom resources by schemas.yaml, and what neither sees."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import yaml
from jsonschema import validators

from .manifests import Object, jobs, of_kind, shown

# The oldest Kubernetes that decides by a pod's exit code without a feature gate, and the newest that the validator knows.
VERSIONS = ("1.31.0", "1.37.0")
# Lists of a pod that Kubernetes merges by a key, so that no two items may share it.
KEYED = {"containers": "name", "env": "name", "volumes": "name", "volumeMounts": "mountPath"}
QUANTITY = re.compile(r"[0-9]+(\.[0-9]+)?(m|k|[MGTPE]|[KMGTPE]i)?")


def closed(schema: Any) -> Any:
    """Returns a schema that allows no other properties than those it lists."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    same = {key: closed(part) for key, part in schema.items()}
    return {"type": "object", "additionalProperties": False, **same} if "properties" in schema else same


# Those of custom resources, which the validator does not know.
SCHEMAS = closed(yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text()))


def repeated(_: Any, keys: list[str], items: Any, schema: Object) -> Iterator[jsonschema.ValidationError]:
    """Checks `x-kubernetes-list-map-keys`: no two items of a list may have the same values of these keys."""
    if isinstance(items, list):
        found = [str([item.get(key) for key in keys]) for item in items if isinstance(item, dict)]
        twice = sorted({values for values in found if found.count(values) > 1})
        yield from (jsonschema.ValidationError(f"more than one item with {keys} = {values}") for values in twice)


Validator = validators.extend(jsonschema.Draft202012Validator, {"x-kubernetes-list-map-keys": repeated})


def invalid(objects: list[Object]) -> Iterator[str]:
    """Yields what the schemas refuse, those of each version of Kubernetes, unknown fields included."""
    # What follows needs the parts that our schemas require.
    custom = []
    for thing in of_kind(objects, *SCHEMAS):
        errors = [f"{error.json_path}: {error.message}" for error in Validator(SCHEMAS[thing["kind"]]).iter_errors(thing)]
        errors += (f"{path}: is null" for path in nulls(thing))
        yield from (f"{shown(thing)}: {error}" for error in errors)
        custom += [] if errors else [thing]
    known = [(shown(thing), thing) for thing in objects if thing["kind"] not in SCHEMAS]
    for job in jobs(custom):
        made = {"apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": job["name"]}, "spec": job["template"]["spec"]}
        known.append((shown(made), made))
    # An object that is little else than its metadata.
    head = {"apiVersion": "v1", "kind": "ConfigMap"}
    known += [(shown(thing), {**head, "metadata": thing["metadata"]}) for thing in custom]
    for name, thing in known:
        yield from (f"{name}: {error}" for error in unseen(thing))
        for version in VERSIONS:
            try:
                kubernetes_validate.validate(thing, version, strict=True)
            except kubernetes_validate.ValidationError as error:
                yield f"{name}, {version}: {'.'.join(map(str, error.path))}: {error.message}"
            except (kubernetes_validate.SchemaNotFoundError, kubernetes_validate.InvalidSchemaError) as error:
                yield f"{name}, {version}: {error}"


def nulls(part: Any, path: str = "$") -> Iterator[str]:
    """Yields where a null stands. In Kubernetes' own objects it is as good as nothing, in custom resources an error."""
    if part is None:
        yield path
    for key, value in part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ():
        yield from nulls(value, f"{path}.{key}")


def unseen(part: Any, path: str = "$") -> Iterator[str]:
    """Yields what Kubernetes refuses and the validator allows: a quantity that is none, and a key that is there twice."""
    if isinstance(part, dict):
        quantities = [(key, part[key]) for key in ("divisor", "sizeLimit") if key in part]
        for kind in ("requests", "limits"):
            quantities += part[kind].items() if isinstance(part.get(kind), dict) else ()
        for key, value in quantities:
            if isinstance(value, float) or not QUANTITY.fullmatch(str(value)):
                yield f"{path}: {key} is {value!r}, not a quantity"
        for name, key in KEYED.items():
            yield from (f"{path}.{name}: {error.message}" for error in repeated(None, [key], part.get(name), {}))
    for key, value in part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ():
        yield from unseen(value, f"{path}.{key}")
