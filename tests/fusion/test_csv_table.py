"""Time-stamped tables: exact when whole, reported when dirty, refused when useless."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion.logs.csv.rows import parse_time
from fusion.logs.csv.stamped_table import CsvTable, read_table
from fusion.logs.samples import order_times
from vision import InputError

T0 = 1_600_001_000_000_000_001  # odd: a float would lose it
STEP = 5_000_000
HEADER = "#timestamp [ns],a [m],b [m]\n"


def rows(n: int, start: int = 0) -> list[str]:
    return [f"{T0 + i * STEP},{i}.25,-{i}.5" for i in range(start, start + n)]


def read(path: Path, text: str, *, by_name: bool = False) -> tuple[CsvTable, list[str]]:
    path.mkdir(exist_ok=True)
    (path / "data.csv").write_bytes(text.encode())
    table, problems = read_table(path / "data.csv", ("a", "b"), label="x0/data.csv", by_name=by_name)
    return table, list(problems)


def lines(*parts: str) -> str:
    return "".join(f"{part}\n" for part in parts)


@pytest.mark.parametrize(
    "header", ["", HEADER, "timestamp_ns,a,b\n", "# a remark\n" + HEADER, "\ufeff" + HEADER]
)
@pytest.mark.parametrize("end", ["\n", ""])
def test_a_whole_file_is_read_to_the_last_digit(tmp_path: Path, header: str, end: str) -> None:
    table, problems = read(tmp_path, header + "\n".join(rows(9)) + end)
    assert problems == []
    assert table.t_ns.tolist() == [T0 + i * STEP for i in range(9)]
    assert table.values.tolist() == [[i + 0.25, -i - 0.5] for i in range(9)]


def test_remarks_and_blank_lines_among_the_rows(tmp_path: Path) -> None:
    table, problems = read(tmp_path, HEADER + lines(*rows(3), "", "# restarted", "  ", *rows(3, 3)))
    assert problems == []
    assert len(table.t_ns) == 6


def test_one_row_is_a_table(tmp_path: Path) -> None:
    table, problems = read(tmp_path, HEADER + lines(*rows(1)))
    assert table.values.shape == (1, 2)
    assert problems == []


@pytest.mark.parametrize("kept", range(1, len(rows(1, 8)[0])))
def test_a_last_line_cut_anywhere_is_never_taken_for_a_number(tmp_path: Path, kept: int) -> None:
    text = HEADER + lines(*rows(8)) + rows(1, 8)[0][:kept]
    table, problems = read(tmp_path, text)
    assert len(table.t_ns) == 8
    assert problems == ["x0/data.csv: the last line is cut short, dropped"]


def test_rows_that_are_none_are_dropped(tmp_path: Path) -> None:
    text = lines(
        *rows(4), "garbage", f"{T0 + 4 * STEP},1.0", f"{T0},1.0,2.0,3.0", f"{T0},1.0,zwei", *rows(4, 4)
    )
    table, problems = read(tmp_path, HEADER + text)
    assert len(table.t_ns) == 8
    assert problems == ["x0/data.csv: 4 rows not of 3 numbers dropped, the first is 'garbage'"]


@pytest.mark.parametrize("time", ["1600001000.5", "1.6e18", "nan", "", "99999999999999999999", "0x10"])
def test_a_row_without_a_whole_time_is_dropped(tmp_path: Path, time: str) -> None:
    table, problems = read(tmp_path, HEADER + lines(*rows(5), f"{time},1.0,2.0", *rows(5, 5)))
    assert len(table.t_ns) == 10
    assert problems == [f"x0/data.csv: 1 row not of 3 numbers dropped, the first is {f'{time},1.0,2.0'!r}"]


def test_zeros_left_by_a_power_cut(tmp_path: Path) -> None:
    table, problems = read(tmp_path, HEADER + lines(*rows(5)) + "\0" * 300)
    assert len(table.t_ns) == 5
    assert problems == ["x0/data.csv: the last line is cut short, dropped"]


def test_an_empty_field_is_nan(tmp_path: Path) -> None:
    table, problems = read(
        tmp_path, HEADER + lines(*rows(4), f"{T0 + 4 * STEP},,7.0", f"{T0 + 5 * STEP},nan,inf")
    )
    assert problems == []
    assert np.isnan(table.values[4, 0])
    assert table.values[4, 1] == 7.0
    assert np.isnan(table.values[5, 0])
    assert np.isinf(table.values[5, 1])


def test_a_bad_row_far_into_a_long_file(tmp_path: Path) -> None:
    many = rows(9000)
    many[7000] = "oops"
    table, problems = read(tmp_path, HEADER + lines(*many))
    assert len(table.t_ns) == 8999
    assert table.values[-1].tolist() == [8999.25, -8999.5]
    assert problems == ["x0/data.csv: 1 row not of 3 numbers dropped, the first is 'oops'"]


def test_unsorted_and_repeated_times(tmp_path: Path) -> None:
    good = rows(6)
    repeated = good[2].replace("2.25", "9.75")
    table, problems = read(tmp_path, HEADER + lines(good[0], good[2], good[1], repeated, *good[3:]))
    assert table.t_ns.tolist() == [T0 + i * STEP for i in range(6)]
    assert table.values[:, 0].tolist() == [
        i + 0.25 for i in range(6)
    ]  # of the two, the earlier row in the file
    assert problems == [
        f"x0/data.csv: times go backwards in 1 place (first at {T0 + STEP}), rows sorted",
        f"x0/data.csv: 1 row with a repeated time (first {T0 + 2 * STEP}) dropped",
    ]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=st.lists(st.integers(600_000, 10**10), min_size=1, max_size=30),
    seed=st.integers(0, 2**32 - 1),
    data=st.data(),
)
def test_any_order_of_rows_reads_as_the_sorted_file(
    tmp_path: Path, steps: list[int], seed: int, data: st.DataObject
) -> None:
    t_ns = np.cumsum(np.array([T0, *steps]))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    values = data.draw(st.lists(st.tuples(finite, finite), min_size=len(t_ns), max_size=len(t_ns)))
    order = np.random.default_rng(seed).permutation(len(t_ns))
    text = lines(*(f"{t_ns[i]},{values[i][0]!r},{values[i][1]!r}" for i in order))
    table, problems = read(tmp_path, HEADER + text)
    np.testing.assert_array_equal(table.t_ns, t_ns)
    np.testing.assert_array_equal(table.values, values)
    assert len(problems) == int((np.diff(order) < 0).any())


@given(st.lists(st.integers(0, 20), min_size=1, max_size=40))
def test_ordered_times_are_the_distinct_ones(times: list[int]) -> None:
    t_ns = np.array(times, dtype=np.int64)
    index, problems = order_times(t_ns, "x")
    assert t_ns[index].tolist() == sorted(set(times))
    assert [times.index(t) for t in t_ns[index]] == index.tolist()  # the first of equal ones
    assert bool(problems) == (times != sorted(set(times)))


@pytest.mark.parametrize(
    ("field", "t_ns"),
    [("12", 12), ("-5", -5), ("9223372036854775807", 2**63 - 1), ("9223372036854775808", None)]
    + [(bad, None) for bad in ("", "1.0", "1e9", " 1", "1_000", "٣")],
)
def test_parse_time(field: str, t_ns: int | None) -> None:
    assert parse_time(field) == t_ns


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", r"is empty \(the file was not written whole"),
        ("\n\n", "is empty"),
        (HEADER, "has a header but no rows"),
        (
            lines(*[f"{row},1.0" for row in rows(5)]),
            r"rows of 4 columns instead of 3 \(the columns are timestamp, a, b",
        ),
        (lines(*[row.rsplit(",", 1)[0] for row in rows(5)]), "rows of 2 columns instead of 3"),
        (lines(*[row.replace(",", ":") for row in rows(5)]), "rows of 1 column instead of 3"),
        (
            lines(*[f"{1.6e9 + i / 200},1,2" for i in range(5)]),
            "timestamp 1600000000.0 is not a whole number",
        ),
        (
            lines(*[f"{1600 + i},1,2" for i in range(5)]),
            "1 apart, not nanoseconds .*like seconds or milliseconds",
        ),
        (lines(*[f"{5 * i},1,2" for i in range(5)]), "5 apart.*look like milliseconds: multiply by 1e6"),
        (
            lines(*[f"{5000 * i},1,2" for i in range(5)]),
            "5000 apart.*look like microseconds: multiply by 1000",
        ),
        (lines("x,y,z", "a,b,c", "d,e,f"), "has no row of 3 numbers"),
    ],
)
def test_files_of_no_use(tmp_path: Path, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        read(tmp_path, text)
    assert caught.value.file == tmp_path / "data.csv"
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_columns_by_name(tmp_path: Path) -> None:
    text = "timestamp_ns,b [m],extra,a\n" + lines(f"{T0},1,2,3", f"{T0 + STEP},4,5,6")
    table, problems = read(tmp_path, text, by_name=True)
    assert table.values.tolist() == [[3.0, 1.0], [6.0, 4.0]]
    assert problems == []
    with pytest.raises(InputError, match="has no column b"):
        read(tmp_path, text.replace("b [m]", "c [m]"), by_name=True)
    table, _ = read(tmp_path, lines(*rows(3)), by_name=True)
    assert table.values[1].tolist() == [1.25, -1.5]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", ";").replace(".", ","),
        lambda text: text.replace(",", "\t").replace(".", ","),
        lambda text: text.replace(",", " ; "),
        lambda text: text.replace("#timestamp [ns]", "#timestamp").replace(" [m]", "").replace(",", "  "),
        lambda text: "".join(
            ",".join(f'"{field}"' for field in line.split(",")) + "\n" for line in text.splitlines()
        ),
    ],
    ids=["semicolons", "decimal commas", "tabs", "blanks and semicolons", "blanks", "quotes"],
)
@pytest.mark.parametrize("header", ["", HEADER])
def test_separators_and_quotes(tmp_path: Path, change: Callable[[str], str], header: str) -> None:
    table, problems = read(tmp_path, change(header + lines(*rows(9))))
    assert problems == []
    assert table.t_ns.tolist() == [T0 + i * STEP for i in range(9)]
    assert table.values.tolist() == [[i + 0.25, -i - 0.5] for i in range(9)]


IMU = ("gyro", "accel")
IMU_COLUMNS = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")


def read_roles(
    path: Path, names: str, values: str, roles: tuple[str, ...], columns: tuple[str, ...]
) -> list[float]:
    text = f"{names}\n" + lines(*(f"{T0 + i * STEP},{values}" for i in range(3)))
    (path / "data.csv").write_text(text, encoding="utf-8")
    table, problems = read_table(path / "data.csv", columns, label="x", roles=roles)
    assert problems == ()
    assert (table.values == table.values[0]).all()
    row: list[float] = table.values[0].tolist()
    return row


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ("#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z", "1,2,3,4,5,6"),
        ("#timestamp [ns],a_x,a_y,a_z,w_x,w_y,w_z", "4,5,6,1,2,3"),
        (
            "#timestamp [ns],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2],w_RS_S_x [rad s^-1],"
            "w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]",
            "4,5,6,1,2,3",
        ),
        ("timestamp,accel_z,accel_y,accel_x,gyro_z,gyro_y,gyro_x", "6,5,4,3,2,1"),
        ("timestamp,temperature,gx,gy,gz,ax,ay,az,state", "9,1,2,3,4,5,6,idle"),
        (
            "#timestamp,w_x [mrad/s],w_y [mrad/s],w_z [mrad/s],a_x [cm/s^2],a_y [cm/s^2],a_z [cm/s^2]",
            "1000,2000,3000,400,500,600",
        ),
        ("", "1,2,3,4,5,6"),
        ("#timestamp,one,two,three,four,five,six", "1,2,3,4,5,6"),
        ("#timestamp,w_x,w_y,w_z,four,five,six", "1,2,3,4,5,6"),
        ("#timestamp,w_x,w_y,w_z", "1,2,3,4,5,6"),
        ("#timestamp,w_x,w_y,w_z,w_x,w_y,w_z", "1,2,3,4,5,6"),
    ],
)
def test_columns_by_the_names_in_the_header_or_else_by_their_order(
    tmp_path: Path, names: str, values: str
) -> None:
    assert read_roles(tmp_path, names, values, IMU, IMU_COLUMNS) == pytest.approx([1, 2, 3, 4, 5, 6])


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (
            "#timestamp,a_x,a_y,a_z,u,v,w",
            r"has a_x in column 2, but no column w_x, w_y, w_z \(name every column",
        ),
        ("#timestamp,a_x,a_y,a_z,w_x,w_y,w_y", "has w_x in column 5, but no column w_y, w_z"),
        ("#timestamp,x,w_x,w_y,w_z,a_x,a_y", "has w_x in column 3, but no column a_z"),
    ],
)
def test_a_header_that_contradicts_the_order(tmp_path: Path, names: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        read_roles(tmp_path, names, "1,2,3,4,5,6", IMU, IMU_COLUMNS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("role", "names", "values", "expected"),
    [
        ("quaternion", "qx,qy,qz,qw", "1,2,3,4", [4, 1, 2, 3]),
        ("quaternion", "q_RS_x [],q_RS_y [],q_RS_z [],q_RS_w []", "1,2,3,4", [4, 1, 2, 3]),
        ("quaternion", "x,y,z,w", "1,2,3,4", [4, 1, 2, 3]),
        ("quaternion", "qw,qx,qy,qz", "1,2,3,4", [1, 2, 3, 4]),
        ("quaternion", "q0,q1,q2,q3", "1,2,3,4", [1, 2, 3, 4]),
        ("position", "p_RS_R_z [m],p_RS_R_y [m],p_RS_R_x [m]", "1,2,3", [3, 2, 1]),
        ("velocity", "yaw,vx [cm/s],vy [cm/s],vz [cm/s]", "0,100,200,300", [1, 2, 3]),
        ("range", "quality,distance [cm]", "7,100", [1]),
    ],
)
def test_every_stream_by_name(
    tmp_path: Path, role: str, names: str, values: str, expected: list[float]
) -> None:
    columns = tuple(f"column{i}" for i in range(len(expected)))
    assert read_roles(tmp_path, f"#timestamp [ns],{names}", values, (role,), columns) == pytest.approx(
        expected
    )


def test_a_folder_in_place_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_table(tmp_path, ("a", "b"), label="x")
