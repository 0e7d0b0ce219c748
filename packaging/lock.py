"""requirements.lock: exact versions with the hashes of their files, which pip checks at every installation.

    python packaging/lock.py write PYLOCK   make it of what uv resolved (`make lock`)
    python packaging/lock.py pins           its versions alone, for --constraint
    python packaging/lock.py of NAME...     its lines for some packages, for --require-hashes; `@REPORT` names those of
                                            a report of pip (--dry-run --report), a folder the wheels that lie in it
    python packaging/lock.py sbom [FILE]    the parts of a release as CycloneDX 1.6, JSON

Standard library only: a machine that installs has nothing else yet.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
HEAD = """\
# What `make` installs: the exact versions the tests ran with, on Python 3.11 to 3.13, x86-64 and aarch64, and the
# hashes of their files for these. Written by `make lock`; pip checks it (--require-hashes).
"""
PYTHONS = ("311", "312", "313")
MACHINES = ("x86_64", "aarch64")
WHEEL = re.compile(
    r"^(?P<name>.+?)-(?P<version>[^-]+)(-\d[^-]*)?-(?P<python>[^-]+)-(?P<abi>[^-]+)-(?P<platform>[^-]+)\.whl$"
)


@dataclass(frozen=True)
class Locked:
    """A package of the lock: its normal name, its version, the sha256 of the files that may be installed."""

    name: str
    version: str
    sha256: tuple[str, ...]

    @property
    def pin(self) -> str:
        """Return the line without hashes."""
        return f"{self.name}=={self.version}"

    @property
    def text(self) -> str:
        """Return the lines with hashes."""
        return " \\\n".join([self.pin, *(f"    --hash=sha256:{digest}" for digest in self.sha256)])


def normal(name: str) -> str:
    """Return a package's name as PyPI compares them."""
    return re.sub(r"[-_.]+", "-", name).lower()


def read(lock: Path = LOCK) -> dict[str, Locked]:
    """Return the packages of the lock by their normal names."""
    text = re.sub(r"\s*\\\n\s*", " ", lock.read_text(encoding="utf-8"))
    found = {}
    for line in text.splitlines():
        if line and not line.startswith("#"):
            pin, *hashes = line.split()
            name, version = pin.split("==")
            found[normal(name)] = Locked(normal(name), version, tuple(h.removeprefix("--hash=sha256:") for h in hashes))
    return found


def fits(file: str) -> bool:
    """Return whether a wheel is for one of our Pythons and processors, under glibc."""
    parts = WHEEL.match(file)
    if parts is None:
        return False
    pythons, abis = parts["python"].split("."), parts["abi"].split(".")
    is_ours = any(
        python in ("py3", "py2")
        or python in {f"cp{minor}" for minor in PYTHONS}
        or python in {f"py{minor}" for minor in PYTHONS}
        or ("abi3" in abis and re.fullmatch(r"cp3\d+", python) is not None and int(python[3:]) <= int(PYTHONS[-1][1:]))
        for python in pythons
    )
    is_threaded = all(abi.endswith("t") for abi in abis)
    platform = parts["platform"]
    return (
        is_ours
        and not is_threaded
        and (platform == "any" or ("linux" in platform and "musl" not in platform and platform.endswith(MACHINES)))
    )


def lines_of(pylock: dict[str, object]) -> list[Locked]:
    """Return the packages of a pylock.toml: of each the wheels that fit, and its source where some machine has none."""
    found = []
    for package in pylock["packages"]:  # type: ignore[attr-defined]
        wheels = {file["url"].rpartition("/")[2]: file["hashes"]["sha256"] for file in package.get("wheels", [])}
        fitting = {file: digest for file, digest in wheels.items() if fits(file)}
        digests = list(fitting.values())
        if "sdist" in package and not serves_all(fitting):
            digests.append(package["sdist"]["hashes"]["sha256"])
        if not digests:
            raise SystemExit(f"lock: no file of {package['name']} {package['version']} is for us")
        found.append(Locked(normal(package["name"]), package["version"], tuple(sorted(digests))))
    return sorted(found, key=lambda locked: locked.name)


def serves_all(files: Iterable[str]) -> bool:
    """Return whether every Python on every processor has one of some wheels."""
    tags = [WHEEL.match(file) for file in files]

    def has(python: str, machine: str) -> bool:
        return any(
            tag is not None
            and (tag["platform"] == "any" or tag["platform"].endswith(machine))
            and ("py3" in tag["python"] or f"cp{python}" in tag["python"] or "abi3" in tag["abi"])
            for tag in tags
        )

    return all(has(python, machine) for python in PYTHONS for machine in MACHINES)


def wanted(words: Iterable[str]) -> list[str]:
    """Return the names that some words ask for: a name, `@REPORT` of pip, a folder of wheels."""
    names: set[str] = set()
    for word in words:
        if word.startswith("@"):
            report = json.loads(Path(word[1:]).read_text(encoding="utf-8"))
            names |= {normal(part["metadata"]["name"]) for part in report["install"]}
        elif Path(word).is_dir():
            names |= {normal(path.name.split("-")[0]) for path in Path(word).glob("*.whl")}
        else:
            names.add(normal(word))
    return sorted(names - {"pointclick"})


def bill_of_materials(names: Iterable[str]) -> dict[str, object]:
    """Return what a release is made of, as CycloneDX: itself, and the packages that it brings, with their hashes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    locked = read()
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": f"pkg:pypi/{project['name']}@{project['version']}",
                "name": project["name"],
                "version": project["version"],
                "purl": f"pkg:pypi/{project['name']}@{project['version']}",
            }
        },
        "components": [
            {
                "type": "library",
                "bom-ref": f"pkg:pypi/{name}@{locked[name].version}",
                "name": name,
                "version": locked[name].version,
                "purl": f"pkg:pypi/{name}@{locked[name].version}",
                "externalReferences": [
                    {
                        "type": "distribution",
                        "url": f"https://pypi.org/project/{name}/{locked[name].version}/",
                        "hashes": [{"alg": "SHA-256", "content": digest} for digest in locked[name].sha256],
                    }
                ],
            }
            for name in names
        ],
    }


def main(arguments: list[str]) -> int:
    """Run one of the commands above."""
    match arguments:
        case ["write", pylock]:
            packages = lines_of(tomllib.loads(Path(pylock).read_text(encoding="utf-8")))
            twice = [name for name, count in Counter(locked.name for locked in packages).items() if count > 1]
            if twice:
                raise SystemExit(f"lock: bound {', '.join(twice)} in pyproject.toml: no one version fits every Python")
            LOCK.write_text(HEAD + "".join(f"{locked.text}\n" for locked in packages), encoding="utf-8")
        case ["pins"]:
            print("\n".join(locked.pin for locked in read().values()))
        case ["of", *words] if words:
            locked = read()
            print("\n".join(locked[name].text for name in wanted(words)))
        case ["sbom", out, *words] if words:
            Path(out).write_text(json.dumps(bill_of_materials(wanted(words)), indent=1) + "\n", encoding="utf-8")
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
