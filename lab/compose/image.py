"""Builds deploy/Dockerfile: the image under test, with a binary built on this machine, and the stage of the sources."""

import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

from checks import Failed, require
from shell import run, works

ROOT = Path(__file__).resolve().parents[2]

# A base image with its own name, so that it never replaces the real one.
BASE = "lodestone-test-base"

# The classic builder is part of the daemon. BuildKit would need a plugin.
CLASSIC = {**os.environ, "DOCKER_BUILDKIT": "0"}


def base_image() -> str:
    """Returns the base image's tag. Builds the image from Debian packages unless an earlier run left it."""
    suite = _suite()
    tag = f"{BASE}:{suite}"
    if works(["docker", "image", "inspect", tag]):
        return tag
    with tempfile.TemporaryDirectory(prefix="lodestone-base-") as folder:
        root = Path(folder) / "root"
        command: list[str | Path] = ["debootstrap", "--variant=minbase", suite, root]
        if mirror := os.environ.get("DEBIAN_MIRROR"):
            command.append(mirror)
        run(command, seconds=600)
        # Not needed because nothing is ever installed. The official slim image drops these too.
        for ballast in ("var/cache/apt/archives", "var/lib/apt/lists", "usr/share/doc", "usr/share/locale", "usr/share/man"):
            shutil.rmtree(root / ballast, ignore_errors=True)
        with subprocess.Popen(["tar", "-C", root, "-c", "."], stdout=subprocess.PIPE) as packed:
            imported = subprocess.run(["docker", "import", "-", tag], stdin=packed.stdout, capture_output=True, check=False)
        require(imported.returncode == 0 and packed.returncode == 0, f"docker import: {imported.stderr.decode()}")
    return tag


def runtime_image(binary: Path, tag: str) -> int:
    """Builds the image `tag` with `binary` and returns its size in bytes."""
    with tempfile.TemporaryDirectory(prefix="lodestone-context-") as folder:
        run(["strip", "-o", Path(folder) / "lodestone", binary])
        Path(folder, "lodestone").chmod(0o755)
        _build("prebuilt", folder, tag, BINARY="lodestone")
    return int(run(["docker", "image", "inspect", "--format", "{{.Size}}", tag]))


def read_sources(tag: str) -> None:
    """Builds the stage in which cargo reads the context of the repository, and removes it again.

    This machine's cargo stands in for the image with Rust, because no registry is needed to read manifests.
    """
    cargo, rust = f"{tag}-cargo", f"{tag}-sources"
    with tempfile.TemporaryDirectory(prefix="lodestone-cargo-") as folder:
        shutil.copy2(Path(run(["rustc", "--print", "sysroot"]).strip()) / "bin/cargo", folder)
        Path(folder, "Dockerfile").write_text(f"FROM {base_image()}\nCOPY cargo /usr/local/bin/cargo\n")
        run(["docker", "build", "--quiet", "--tag", cargo, folder], env=CLASSIC)
    try:
        _build("sources", ROOT, rust, RUST_IMAGE=cargo)
        remove_image(rust)
    finally:
        remove_image(cargo)


def _build(stage: str, context: str | Path, tag: str, **arguments: str) -> None:
    """Builds a stage of deploy/Dockerfile."""
    given = [f"--build-arg={name}={value}" for name, value in {"BASE_IMAGE": base_image(), **arguments}.items()]
    file = ["--file", ROOT / "deploy/Dockerfile", "--target", stage, "--tag", tag]
    run(["docker", "build", "--quiet", "--force-rm", *file, *given, context], env=CLASSIC)


def remove_image(tag: str) -> None:
    """Removes `tag` and its unused layers."""
    run(["docker", "image", "rm", "--force", tag])


def _suite() -> str:
    """Returns this machine's Debian release, because the binary needs the C library it was built with."""
    about = platform.freedesktop_os_release()
    if about.get("ID") != "debian" or "VERSION_CODENAME" not in about:
        raise Failed("the image's base is made from this machine's Debian release, and this is no Debian")
    return about["VERSION_CODENAME"]
