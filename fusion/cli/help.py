"""What ``corridor --help`` teaches. A line that holds only a backspace keeps its paragraph's layout."""

CORRIDOR = """Heading and lateral offset in indoor corridors, from camera frames fused with an IMU.

\b
First steps:
  corridor fuse data/office           fuse the sample flight; then open office_fused/report.html
  corridor inspect log.ulg            what a log holds, what is missing, how to supply it
  corridor align data/office          is the camera in time with the IMU, does its focal length fit?
  corridor config > my.toml           all settings with their meaning, to edit and give to fuse
  corridor evaluate office_fused --truth data/office    errors against the truth, outputs side by side
  corridor measure picture.jpg        one picture: no IMU, no calibration needed
  corridor simulate flight            make a flight of your own to try it on, truth included

Heading is the angle from the corridor's axis to the vehicle's nose, positive when turned right; lateral
offset is positive right of the centre line. Files hold radians, metres and nanoseconds.

Results go to stdout, notes and progress to stderr. Exit code 0: done; 2: input that cannot be used, one line
says why; 130: interrupted.

`corridor COMMAND --help` says more about each command.
"""

FUSE = """Fuse a logged flight into a smooth heading and lateral offset.

\b
FLIGHT is one of
  a folder in ASL / EuRoC layout, the truth beside it if known: mav0/cam0/{sensor.yaml,data.csv,data/*}, and as
    there are mav0/imu0, mav0/attitude0, mav0/velocity0, mav0/position0, mav0/range0; corridor_truth.csv
  a ROS 1 or 2 bag or MCAP with pictures
  a flight.toml, or the folder that holds it: where each stream comes from, see below
  a PX4 ULog, ArduPilot DataFlash log, MAVLink tlog or CSV, together with --video
Without FLIGHT: --imu and --video name the files; their clocks may differ by --clock-offset.

\b
OUT gets these, whole or not at all; an earlier output there is replaced:
  estimates.csv   the causal filter, a row per IMU sample: heading, offset, sigmas, bias, status
  smoothed.csv    the same after the backward pass: the best answer once the flight is over
  frames.csv      a row per camera frame: what vision saw, used or not, and why
  summary.json    verdict, counts, timings, errors against the truth
  report.html     all of it to look at, in one file
  flight.toml     where every stream came from, to fuse again or for `corridor align`

\b
With --export, also:
  parquet   estimates, smoothed, frames .parquet: the tables with units and frames in their metadata
  tum       estimates.tum, smoothed.tum: trajectories for evo
  mcap      flight.mcap: pictures with what was seen in them, estimates and events, for Foxglove

\b
Examples:
  corridor fuse data/office
  corridor fuse data/office --export parquet,mcap --frame ros
  corridor fuse flights/hall -o out/hall --config hall.toml
  corridor fuse flights/hall --camera camchain.yaml --method paper
  corridor fuse log.ulg --video hall.mp4 --camera cam.yaml --clock-offset 12.85
  corridor fuse --imu imu.csv --video pictures/ --camera cam.yaml

\b
flight.toml, for streams in several files; paths count from its folder, flight time = file time + clock_offset_s:
  corridor_width_m = 2.2
  [camera]
  file = "hall.mp4"              # or a folder of pictures; times = "times.csv" where a CSV has the frames' times
  calibration = "camera.yaml"
  clock_offset_s = 12.85
  [imu]
  file = "imu.csv"               # or a log; topic = "/imu/data" chooses one of several
  frame = "flu"                  # x ahead, y left, z up; frd is x ahead, y right, z down
  columns = { time = "t", time_unit = "ms", gyro = ["gx", "gy", "gz"], gyro_unit = "deg/s" }
  [attitude]
  file = "state.csv"
  columns = "tello"              # ready maps: tello, ardrone, ardrone_ros

\b
hall.toml, for offsets in metres where the log has no range sensor:
  corridor_width_m = 2.2

Next: open OUT/report.html, or read the tables: pandas.read_csv("OUT/estimates.csv").
"""

INSPECT = """Say what a log holds, and what can be made of it: streams, rates, gaps, clocks, noise, the first picture.

Any format that `corridor fuse` takes. It looks at a handful of pictures only, and at the rest of a log where a part
cannot be read.

\b
Told for each stream:
  rate, jitter   one over the usual (median) step, and how far 95 of 100 steps are from it
  gaps           stretches of more than three usual steps; also repeated times and jumps of the clock
  frames covered the share of the frames that lie within the stream
  IMU            still periods, and in them white noise (Allan deviation at 0.1 s), bias and gravity

What the data contradict is said too: degrees for radians, g for m/s^2, reversed axes, clocks that do not overlap.

\b
Examples:
  corridor inspect data/office
  corridor inspect log.ulg --json > log.json
  corridor inspect flight.bag --picture first.png

Next: supply what it says is missing, then corridor fuse.
"""

MEASURE = """Measure single pictures of a corridor: heading, lateral offset, vanishing point. No filter.

Folders are taken with all the pictures in them. The table goes to stdout as CSV, or to a file with -o; its
columns are those of frames.csv, with the picture first. A picture that does not decode is a row with the
reason `unreadable`. A picture's name that is an integer is taken for its time in nanoseconds.

\b
What is assumed unless given:
  --camera      a lens without distortion that looks straight ahead; its horizontal field of view from, in this order,
                --fov, the focal length in the picture's EXIF, the right angles in all pictures of one size, or
                65 +- 20 degrees. It is said which, and the headings' sigma includes it.
  --attitude    level, within about 12 degrees

\b
--attitude CSV is one of
  timestamp_ns,qw,qx,qy,qz     body to world as in attitude0/data.csv (FLU, z up), matched by nearest time
  image,roll_rad,pitch_rad     with these names in the first line; roll right side down, pitch nose up

\b
Examples:
  corridor measure picture.jpg
  corridor measure hall/mav0/cam0/data --camera hall/mav0/cam0/sensor.yaml -o frames.csv --overlay drawn
  corridor measure *.jpg --fov 54 -o frames.csv
  corridor measure *.png --attitude tilt.csv > frames.csv

Next: look at the drawings in --overlay DIR; with an IMU log, `corridor fuse` makes it smooth.
"""

SIMULATE = """Make a flight through a furnished, lit corridor: pictures, IMU, attitude and the exact truth.

The same settings give the same files, byte for byte. OUT is a flight folder as `corridor fuse` takes it; it must not
exist yet.

\b
Examples:
  corridor simulate flight
  corridor simulate turn --turn -65 --duration 30 --seed 7
  corridor simulate dark --config dark.toml --size 640x480

\b
dark.toml, a table per part (scene, camera, imaging, motion, imu, attitude, range), names with their units:
  [imaging]
  brightness = 0.02
  [camera]
  exposure_s = 0.02

Next: corridor fuse OUT, which then reports its errors against the truth.
"""

CONFIG = """Print every setting with its value, unit, bounds and meaning, as TOML to edit and give back.

Without a file these are the defaults; with one, the settings as that file makes them, so that it can be seen what
they come to. A name that does not exist, a wrong unit or a value out of bounds is refused with the nearest right one.

\b
Examples:
  corridor config > my.toml
  corridor config my.toml
  corridor config --simulate > hall.toml

Next: edit what you want to change, delete the rest, then `corridor fuse FLIGHT --config my.toml`.
"""

EVALUATE = """Compare fused flights with what the vehicle really did, several outputs side by side.

RMSE and MAE (the article's equations 9 and 10), the largest error, percentiles, NEES and the share of time in each
status; for heading and lateral offset, for the causal filter and the smoother, in all and per corridor. Judged are
rows that are tracking, outside junctions and within the truth's time; all others are counted.

\b
FILE is one of
  corridor_truth.csv               or the flight's folder that holds it
  CSV with names in its first line: a time (timestamp_ns, timestamp_us, timestamp_ms or timestamp_s) and one of
      heading_rad, heading_deg     from the axis of the corridor being flown, positive right
      yaw_rad, yaw_deg             from one fixed axis; give --truth-frame
      qw,qx,qy,qz                  the same as a quaternion, body to world
    and as known lateral_offset_m (or _norm), corridor_width_m, corridor_id, in_junction
  estimates.csv or smoothed.csv    of another output
  a TUM trajectory                 timestamp_s x y z qx qy qz qw: yaw from x, y as the offset; give --truth-frame

\b
Examples:
  corridor evaluate office_fused --truth data/office
  corridor evaluate geometric paper --truth data/office/corridor_truth.csv --json
  corridor evaluate hall_fused --truth mocap.tum --truth-frame ros --align

Next: `corridor fuse --config` with other settings into another OUT, and compare the two.
"""
