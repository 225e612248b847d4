"""Put the estimates by anew, on purpose, and say by how much they changed.

    python -m tests.golden.renew [--inputs]

``--inputs`` also measures the sample flight's pictures again and simulates the junction again.
"""

from __future__ import annotations

import argparse

from tests.golden import golden


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", action="store_true", help="make the stored measurements anew too")
    if parser.parse_args().inputs:
        columns = ["timestamp_ns", *golden.frame_columns()]
        golden.write_rows(golden.HERE / "office_frames.csv.gz", columns, golden.measure_office())
        golden.write_rows(
            golden.HERE / "junction_inputs.csv.gz", golden.JUNCTION_COLUMNS, golden.simulate_junction()
        )
    for name, fuse in golden.FLIGHTS.items():
        tables = dict(zip(("filter", "smoother"), fuse(), strict=True))
        path = golden.golden_file(name)
        if path.exists():
            old = golden.read_table(path)
            changes = [
                line
                for which, table in tables.items()
                for line in golden.differences(f"{name} {which}", old[which], table[:: golden.EVERY])
            ]
            print("\n".join(changes) or f"{name}: no change")
        golden.write_table(path, tables["filter"], tables["smoother"])
        print(f"{name}: wrote {path.name}, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
