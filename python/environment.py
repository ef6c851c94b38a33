#!/usr/bin/env python3
"""Creates a virtual environment with the packages of a requirements file.

    python3 python/environment.py target/python python/requirements.txt

uv downloads packages in parallel: PyPI's torch for Linux with its CUDA libraries, 3 GB, takes 40 s instead of the three
to five minutes that pip takes. If PyTorch's own index is reachable, the CPU-only build of torch comes from there. uv
caches its downloads.
"""

import subprocess
import sys
import venv
from pathlib import Path

UV = "uv==0.13.9"


def main() -> int:
    """Returns the exit code of the installation. uv reports any error itself."""
    if len(sys.argv) != 3:
        sys.exit(f"usage: python3 {sys.argv[0]} FOLDER REQUIREMENTS")
    folder, requirements = Path(sys.argv[1]), sys.argv[2]
    python = folder / "bin/python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    subprocess.run([python, "-m", "pip", "install", "-q", UV], check=True)
    install = [folder / "bin/uv", "pip", "install", "-q", "--python", python, "-r", requirements]
    for_cpus = subprocess.run([*install, "--torch-backend", "cpu"], stderr=subprocess.PIPE, text=True, check=False)
    if for_cpus.returncode == 0:
        return 0
    reason = (for_cpus.stderr.splitlines() or ["uv gave no reason"])[0]
    print(f"no build of PyTorch for CPUs ({reason}); PyPI's follows", file=sys.stderr)
    return subprocess.run(install, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
