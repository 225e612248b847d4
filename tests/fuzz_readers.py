"""Fuzz one reader, guided by coverage (atheris), or all of them in turn.

    python tests/fuzz_readers.py [TARGET ...] [--seconds 60]

needs ``pip install atheris``, which is no dependency of the project. A target begins with its files in
`tests.reader_targets`. A file that fails, takes longer than 15 s or more than 1 GiB is put into
``tests/corpus/TARGET``, where `tests.test_reader_fuzz` reads it from then on. The exit code is 1 if there was one.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

#: Whose coverage guides: all but compiled loops, since numba refuses code that has been instrumented.
READERS = [
    "fusion.logs",
    "fusion.settings",
    "fusion.inspection",
    "fusion.pictures",
    "fusion.result.tables_csv",
]
READERS += ["fusion.evaluation.truth_file", "vision.cameras", "vision.limits", "pyulog"]
COMPILED = ["fusion.logs.autopilot.dataflash_parse", "fusion.logs.autopilot.tlog_parse"]


def fuzz(name: str, arguments: list[str]) -> None:
    """Fuzz a target within this process; ends it."""
    import atheris

    with atheris.instrument_imports(include=READERS, exclude=COMPILED):
        import fusion.logs
        from tests.reader_targets import TARGETS, survives

        # Readers load when a log is opened: too late for their coverage to be measured.
        for module in walk_packages(fusion.logs.__path__, "fusion.logs."):
            import_module(module.name)
    target = TARGETS[name]
    with TemporaryDirectory() as work:
        corpus = Path(work) / "corpus"
        corpus.mkdir()
        for number, seed in enumerate(target.seeds()):
            (corpus / str(number)).write_bytes(seed)
        atheris.Setup([sys.argv[0], *arguments, str(corpus)], lambda data: survives(target, data, Path(work)))
        atheris.Fuzz()


def main() -> int:
    """Fuzz each target in a process of its own."""
    from tests.reader_targets import CORPUS, TARGETS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--seconds", type=int, default=60, help="for each (default: 60)")
    options = parser.parse_args()
    failed = False
    for name in options.targets or TARGETS:
        (CORPUS / name).mkdir(exist_ok=True)
        limits = [f"-max_total_time={options.seconds}", "-timeout=15", "-rss_limit_mb=1024"]
        limits += [f"-artifact_prefix={CORPUS / name}/", "-print_final_stats=1", "-verbosity=0"]
        print(f"{name}:", flush=True)
        command = [sys.executable, __file__, "--only", name, *limits]
        failed |= subprocess.run(command, check=False).returncode != 0
        if not any((CORPUS / name).iterdir()):
            (CORPUS / name).rmdir()
    return int(failed)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--only"]:
        fuzz(sys.argv[2], sys.argv[3:])
    sys.exit(main())
