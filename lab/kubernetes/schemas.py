"""Validates objects strictly against the oldest and newest Kubernetes schemas that the validator has."""

from collections.abc import Iterator

import kubernetes_validate

from manifests import Object, shown

VERSIONS = ("1.25.0", "1.37.0")


def complaints(objects: list[Object], version: str) -> Iterator[str]:
    """Yields the errors of `kubernetes-validate --strict`."""
    for thing in objects:
        try:
            kubernetes_validate.validate(thing, version, strict=True)
        except kubernetes_validate.ValidationError as error:
            path = ".".join(map(str, error.path))
            yield f"{shown(thing)}: {path}: {error.message}"
        except (kubernetes_validate.SchemaNotFoundError, kubernetes_validate.InvalidSchemaError) as error:
            yield f"{shown(thing)}: {error}"
