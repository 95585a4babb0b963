"""Check that a version can be released, and print its notes: python tools/release.py v1.0.0."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
_PLACEHOLDER = re.compile(r"\.(invalid|example|test)\b|example\.(com|org|net)\b")
"""Domains that nobody can own (RFC 2606)."""


def main(arguments: list[str]) -> int:
    """Print the notes of a release, or what keeps it from being one; return the exit status."""
    (tag,) = arguments
    manifest, project, changelog = read()
    if found := problems(tag, manifest, project, changelog):
        print("\n".join(found), file=sys.stderr)
        return 1
    print(notes(changelog, tag.removeprefix("v")))
    return 0


def read() -> tuple[dict[str, Any], dict[str, Any], str]:
    """Return the manifest, the project's table of pyproject.toml, and the changelog."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return manifest, project, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def problems(tag: str, manifest: Mapping[str, Any], project: Mapping[str, Any], changelog: str) -> list[str]:
    """Return what keeps a tag from being released: versions that differ, and placeholders.

    Parameters
    ----------
    tag : str
        Such as "v1.0.0".
    manifest, project : mapping
        As `read` returns them.
    changelog : str
    """
    version = manifest["version"]
    found = []
    if tag != f"v{version}":
        found.append(f"The tag is {tag}, but blender_manifest.toml says {version}.")
    if not notes(changelog, version):
        found.append(f"CHANGELOG.md has no section {version}.")
    return found + placeholders(manifest, project)


def placeholders(manifest: Mapping[str, Any], project: Mapping[str, Any]) -> list[str]:
    """Return which fields are missing, or at an address that nobody owns."""
    fields = {f"{name} in blender_manifest.toml": manifest.get(name, "") for name in ("maintainer", "website")}
    fields["Support in pyproject.toml"] = project.get("urls", {}).get("Support", "")
    return [
        f"{name} is {value!r}. Enter the real one."
        for name, value in fields.items()
        if not value or _PLACEHOLDER.search(value)
    ]


def notes(changelog: str, version: str) -> str:
    """Return the section of a version in the changelog; "" if it has no section."""
    sections = re.split(r"^## ", changelog, flags=re.MULTILINE)
    return next((text.partition("\n")[2].strip() for text in sections if text.split()[:1] == [version]), "")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
