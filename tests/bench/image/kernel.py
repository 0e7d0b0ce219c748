"""The guest's kernel: Debian's source built as an ordinary program (ARCH=um), with vivid and v4l2loopback."""

import json
import os
import re
import subprocess
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tests.bench.image import cache
from tests.bench.image.host import DEBIAN_KEYS, BenchError, mirror, run

KERNEL = ("linux-source-7.2", "7.2.12-1~bpo13+1", "trixie-backports")
LOOPBACK = ("v4l2loopback-dkms", "0.15.4-2", "sid")
"""Package, version, suite. Debian 12's own v4l2loopback (0.12.7) leaves the sequence at 0 and cannot be used."""

RECIPE = 1
"""Part of the key: raised when the steps below change what comes out."""

CONFIG = Path(__file__).with_name("kernel.config")
PROGRESS_S = 20.0


def kernel() -> Path:
    """The folder with `linux` (the program), `modules/` and `versions.json`; built if it is not cached."""
    key = cache.key_of(*KERNEL, *LOOPBACK, CONFIG.read_bytes(), str(RECIPE))
    return cache.artefact("kernel", key, _build)


def _build(work: Path) -> None:
    scratch = work / "scratch"
    scratch.mkdir()
    versions = _fetch(scratch)
    (tar,) = (scratch / "kernel" / "usr" / "src").glob("linux-source-*.tar.xz")
    cache.say(f"kernel: unpacking {versions['kernel']}")
    run(["tar", "-xf", tar, "-C", scratch])
    (source,) = (path for path in scratch.glob("linux-source-*") if path.is_dir())
    make = partial(_make, source)

    make("defconfig")
    with (source / ".config").open("ab") as file:
        file.write(CONFIG.read_bytes())
    make("olddefconfig")
    _check_config(source / ".config")
    _compile(source)

    make("modules_install", f"INSTALL_MOD_PATH={work / 'modules'}")
    (modules,) = (work / "modules" / "lib" / "modules").iterdir()
    (loopback,) = (scratch / "loopback" / "usr" / "src").glob("v4l2loopback-*")
    make(f"M={loopback}", "modules")
    (modules / "extra").mkdir()
    (loopback / "v4l2loopback.ko").rename(modules / "extra" / "v4l2loopback.ko")
    for link in ("build", "source"):
        (modules / link).unlink(missing_ok=True)
    run(["depmod", "-b", work / "modules", modules.name])
    run(["strip", "-o", work / "linux", source / "linux"])
    (work / "versions.json").write_text(json.dumps({**versions, "release": modules.name}, indent=1) + "\n")
    run(["rm", "-rf", scratch])


def _fetch(scratch: Path) -> dict[str, str]:
    """Both packages unpacked in `scratch`, through an apt configuration of their own that leaves the host's alone."""
    lists = scratch / "apt" / "lists"
    (lists / "partial").mkdir(parents=True)
    (scratch / "apt" / "archives" / "partial").mkdir(parents=True)
    sources = scratch / "apt" / "sources.list"
    suites = (KERNEL[2], LOOPBACK[2])
    sources.write_text("".join(f"deb [signed-by={DEBIAN_KEYS}] {mirror()} {suite} main\n" for suite in suites))
    options = [
        f"-oDir::Etc::sourcelist={sources}",
        "-oDir::Etc::sourceparts=/dev/null",
        f"-oDir::State::lists={lists}",
        f"-oDir::Cache={scratch / 'apt'}",
        "-oAPT::Sandbox::User=root",
    ]
    cache.say(f"kernel: fetching {KERNEL[0]} and {LOOPBACK[0]} from {mirror()}")
    run(["apt-get", *options, "update", "-qq"])
    versions = {}
    for name, (package, version, suite) in (("kernel", KERNEL), ("loopback", LOOPBACK)):
        folder = scratch / name
        folder.mkdir()
        _download(options, (f"{package}={version}", f"{package}/{suite}", package), folder)
        (deb,) = folder.glob("*.deb")
        versions[name] = deb.name.removesuffix(".deb")
        run(["dpkg", "-x", deb, folder])
    return versions


def _download(options: Sequence[str], wanted: Sequence[str], into: Path) -> None:
    """The version that was tried; where the mirror has moved on, what it has instead, and it says so."""
    for choice in wanted:
        try:
            run(["apt-get", *options, "download", "-qq", choice], cwd=into)
        except BenchError as error:
            cache.say(f"kernel: the mirror has no {choice}")
            failure = error
        else:
            return
    raise failure


def _make(source: Path, *words: str) -> None:
    run(["make", "-s", "ARCH=um", *words], cwd=source)


def _check_config(config: Path) -> None:
    """Every line asked for must have survived `olddefconfig`, which drops what it does not know without a word."""
    got = set(config.read_text().splitlines())
    lost = []
    for line in CONFIG.read_text().splitlines():
        match = re.fullmatch(r"(CONFIG_\w+)=(.+)", line)
        if match is None:
            continue
        name, value = match.groups()
        on = any(other.startswith(f"{name}=") for other in got)
        if (value == "n" and on) or (value != "n" and line not in got):
            lost.append(line)
    if lost:
        raise BenchError("this kernel did not take from kernel.config: " + ", ".join(lost))


def _compile(source: Path) -> None:
    """The long part. Every few seconds a word on how far it is; its whole output stays in `build.log` if it fails."""
    log = source.parent.parent / "build.log"
    done = threading.Event()

    def report() -> None:
        while not done.wait(PROGRESS_S):
            compiled = log.read_text(errors="replace").count("  CC ")
            cache.say(f"kernel: {compiled} files compiled (of about 1200)")

    reporter = threading.Thread(target=report, daemon=True)
    jobs = len(os.sched_getaffinity(0))
    with log.open("w") as output:
        reporter.start()
        try:
            code = subprocess.call(
                ["nice", "make", "ARCH=um", f"-j{jobs}"],
                cwd=source,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
            )
        finally:
            done.set()
            reporter.join()
    if code != 0:
        raise BenchError("the kernel did not build:\n" + "\n".join(log.read_text().splitlines()[-30:]))
    log.unlink()
