"""Builds deploy/Dockerfile: the image under test, with a binary built on this machine, and the stage of the sources."""

import os
import platform
import shutil
import tempfile
from pathlib import Path

from ..ring.checks import require
from ..ring.processes import ROOT, Word, run, works
from .ring import inspect

# A base image with its own name, so that it never replaces the real one.
BASE = "lodestone-test-base"

# Not needed because nothing is ever installed. The official slim image drops these too.
BALLAST = ("var/cache/apt/archives", "var/lib/apt/lists", "usr/share/doc", "usr/share/locale", "usr/share/man")

# The classic builder is part of the daemon. BuildKit would need a plugin.
CLASSIC = {**os.environ, "DOCKER_BUILDKIT": "0"}


def base_image() -> str:
    """Returns the base image's tag. Builds the image from Debian packages unless an earlier run left it."""
    # This machine's Debian release, because the binary needs the C library it was built with.
    about = platform.freedesktop_os_release()
    require(about.get("ID") == "debian", "the image's base is made from this machine's Debian release: this is no Debian")
    suite = about["VERSION_CODENAME"]
    tag = f"{BASE}:{suite}"
    if not works(["docker", "image", "inspect", tag]):
        with tempfile.TemporaryDirectory(prefix="lodestone-base-") as folder:
            root, packed = Path(folder) / "root", Path(folder) / "root.tar"
            mirror = [address] if (address := os.environ.get("DEBIAN_MIRROR")) else []
            run(["debootstrap", "--variant=minbase", suite, root, *mirror], seconds=600)
            for ballast in BALLAST:
                shutil.rmtree(root / ballast, ignore_errors=True)
            run(["tar", "-C", root, "-cf", packed, "."])
            run(["docker", "import", packed, tag])
    return tag


def runtime_image(binary: Path, tag: str) -> int:
    """Builds the image `tag` with `binary` and returns its size in bytes."""
    with tempfile.TemporaryDirectory(prefix="lodestone-context-") as folder:
        run(["strip", "-o", Path(folder) / "lodestone", binary])
        Path(folder, "lodestone").chmod(0o755)
        build("prebuilt", folder, tag, BINARY="lodestone")
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
        build("sources", ROOT, rust, RUST_IMAGE=cargo)
        remove_image(rust)
    finally:
        remove_image(cargo)


def build(stage: str, context: Word, tag: str, **arguments: str) -> None:
    """Builds a stage of deploy/Dockerfile."""
    given = [f"--build-arg={name}={value}" for name, value in {"BASE_IMAGE": base_image(), **arguments}.items()]
    file = ["--file", str(ROOT / "deploy/Dockerfile"), "--target", stage, "--tag", tag]
    run(["docker", "build", "--quiet", "--force-rm", *file, *given, context], env=CLASSIC)


def image_is_plain(image: str) -> str:
    """Checks the image's user, health check, and stop signal, and that the program runs without any privilege."""
    about = inspect(image)["Config"]
    require(about["User"] == "10001:10001", f"its user is {about['User']}")
    require(about["Healthcheck"]["Test"] == ["CMD", "lodestone", "healthcheck"], f"{about['Healthcheck']}")
    require(about["StopSignal"] == "SIGTERM", f"{about['StopSignal']}")
    hardened = ["--read-only", "--cap-drop=ALL", "--security-opt=no-new-privileges", "--network=none"]
    return run(["docker", "run", "--rm", *hardened, image, "--version"]).strip()


def remove_image(tag: str) -> None:
    """Removes `tag` and its unused layers."""
    run(["docker", "image", "rm", "--force", tag])
