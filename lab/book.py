#!/usr/bin/env python3
"""Makes the pages of this repository a book, with llms.txt for programs that read, and checks every link in it.

    python3 lab/book.py target/book [--mdbook PROGRAM] [--source ADDRESS] [--demo FOLDER]

The demo that `lab/demo.py` made becomes a chapter. The pages stay where they are: what links to a file that is no page leads to ADDRESS, by default to this checkout. Exits
with 1 if a link of the book leads nowhere, or if a page is missing from it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parents[1]
PARTS = {
    "Use": [
        *("README.md", "docs/usage.md", "docs/settings.md", "docs/dashboard.md", "docs/metrics.md", "docs/blueprints.md"),
        "python/README.md",
    ],
    "Several machines": ["docs/compose.md", "docs/slurm.md", "docs/kubernetes.md", "docs/security.md"],
    "Results": [
        *("docs/results.md", "deploy/pretrained/README.md", "docs/performance.md", "docs/scaling.md", "docs/soak.md"),
        "docs/blueprints/README.md",
    ],
    "Understand and change": [
        *("ARCHITECTURE.md", "CONTRIBUTING.md", "lab/README.md", "fuzz/README.md", "SECURITY.md", "CHANGELOG.md"),
    ],
    "Decisions": [
        *("docs/decisions/README.md", "docs/decisions/paper.md", "docs/decisions/learning.md", "docs/decisions/network.md"),
        *("docs/decisions/physics.md", "docs/decisions/expert.md", "docs/decisions/services.md"),
        "docs/decisions/dependencies.md",
    ],
}
PAGES = [page for pages in PARTS.values() for page in pages]
DEMO = """# Demo

[The page of three runs](demo/index.html): one that learns two to four blocks, the shipped policy, and one that learns a
structure of its own. Nothing runs behind this copy, so that it plays what was recorded.
"""
# Notes beside files, which are read there.
NOTES = (".github/", "tests/", "policy/tests/", "dashboard/")
PICTURES = {".gif", ".png", ".svg"}
LINK = re.compile(r"(?<=\]\()[^)\s]+(?=\))")
FENCE = re.compile(r"^ *```.*?^ *```$", flags=re.MULTILINE | re.DOTALL)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for the book, which is replaced")
    parser.add_argument("--mdbook", default="mdbook", help="the program mdBook [default: from PATH]")
    parser.add_argument("--source", default=ROOT.as_uri(), help="address of the repository's files [default: this checkout]")
    parser.add_argument("--demo", type=Path, help="folder of the demo page, if the book is to have it")
    args = parser.parse_args()
    shutil.rmtree(args.out, ignore_errors=True)
    source = args.out / "src"
    for page in PAGES:
        write(source / in_book(page), linked(page, args.source, source))
    summary = f"# Summary\n\n{listing('#')}"
    if args.demo:
        write(source / "demo.md", DEMO)
        shutil.copytree(args.demo, source / "demo")
        summary += "\n[Demo](demo.md)\n"
    write(source / "SUMMARY.md", summary)
    shutil.copy(ROOT / "lab/book.toml", args.out / "book.toml")
    subprocess.run([args.mdbook, "build", args.out], check=True)
    made = args.out / "book"
    for page in PAGES:
        write(made / in_book(page), (source / in_book(page)).read_text())
    write(made / "llms.txt", overview())
    complaints = [*forgotten(), *broken(made)]
    print(*complaints, f"{len(PAGES)} pages, {len(complaints)} complaints: {made}", sep="\n")
    return 1 if complaints else 0


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def in_book(page: str) -> str:
    """Returns where a page is in the book: mdBook serves `index` for a folder."""
    return re.sub(r"README\.md$", "index.md", page)


def linked(page: str, address: str, source: Path) -> str:
    """Returns a page whose links lead to pages of the book or to the repository, and copies its pictures."""

    def target(match: re.Match[str]) -> str:
        link = match[0]
        if "://" in link or link.startswith("#"):
            return link
        file, _, anchor = link.partition("#")
        path = os.path.normpath(Path(page).parent / file)
        if path in PAGES:
            return in_book(file) + (f"#{anchor}" if anchor else "")
        if Path(path).suffix in PICTURES:
            (source / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / path, source / path)
            return link
        return f"{address}/{path}"

    text = (ROOT / page).read_text()
    fences = FENCE.findall(text)
    parts = [LINK.sub(target, part) for part in FENCE.split(text)]
    return "".join(part + fence for part, fence in zip(parts, [*fences, ""], strict=True))


def title(page: str) -> str:
    found = re.search(r"^# (.+)", (ROOT / page).read_text(), flags=re.MULTILINE)
    return found[1] if found else page


def listing(level: str) -> str:
    """Returns the pages by part, below headings of a level."""
    lines = []
    for part, pages in PARTS.items():
        lines += [f"{level} {part}\n", *(f"- [{title(page)}]({in_book(page)})" for page in pages), ""]
    return "\n".join(lines)


def overview() -> str:
    """Returns the book's pages in the form of https://llmstxt.org."""
    name, about, *_ = re.split(r"\n\n", (ROOT / "README.md").read_text())
    about = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", about)
    return f"{name}\n\n> {' '.join(about.split())}\n\n{listing('##')}"


def forgotten() -> list[str]:
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()
    return [f"{page} is not in the book" for page in listed if page not in PAGES and not page.startswith(NOTES)]


class Page(HTMLParser):
    """What a page of HTML can be reached by, and what it refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.references: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value for name, value in attrs if value}
        self.ids |= {found[name] for name in ("id", "name") if name in found}
        self.references += [found[name] for name in ("href", "src") if name in found and tag in ("a", "img")]


def broken(book: Path) -> list[str]:
    """Returns the references in a book to files or headings that it does not have."""
    # The demo is a page of the program, whose script removes what a copy does not have.
    files = (path for path in book.resolve().rglob("*.html") if path.parent.name != "demo")
    pages = {path: Page(path.read_text()) for path in files}
    found = []
    for path, page in pages.items():
        for reference in page.references:
            if re.match(r"[a-z]+:", reference):
                continue
            file, _, anchor = unquote(reference).partition("#")
            there = (path.parent / file).resolve() if file else path
            there = there / "index.html" if there.is_dir() else there
            if not there.is_file() or (anchor and there in pages and anchor not in pages[there].ids):
                found.append(f"{path.relative_to(book.resolve())}: the link to {reference} leads nowhere")
    return sorted(set(found))


if __name__ == "__main__":
    sys.exit(main())
